"""jax-sysid or sysidentpy on recordings of identify.py: reads what is asked as JSON, prints errors as JSON.

Each is tuned as its documentation does: a state space with a linear bypass, by Adam and then L-BFGS, of several orders
and seeds, its first state from the samples that give `identify` its state; polynomial NARX by FROLS, of several degrees
and lags. What errs least on the last quarter of the recordings, in free run, is tested. Signals are normalised, seconds
of the processor.
"""

import json
import sys
import warnings
from collections.abc import Callable, Iterator
from itertools import count, product
from pathlib import Path
from time import process_time

import numpy as np

ORDERS, NEURONS, EPOCHS = (2, 3, 4), 8, 1000
DEGREES, LAGS, TERMS = (1, 2, 3), (2, 3, 4, 6), 20
Model = Callable[[np.ndarray, np.ndarray], np.ndarray]  # inputs (N, m), first outputs (settle, 1) -> outputs (N, 1)


def state_spaces(us: list[np.ndarray], ys: list[np.ndarray]) -> Iterator[tuple[str, Model]]:
    import jax

    jax.config.update("jax_enable_x64", True)
    import jax.numpy as jnp
    from jax_sysid.models import Model as Peer

    @jax.jit
    def state(x, u, params):
        a, b, inner, driven, bias, outer = params[:6]
        return a @ x + b @ u + outer @ jnp.tanh(inner @ x + driven @ u + bias)

    @jax.jit
    def output(x, u, params):
        return params[6] @ x + params[7] @ u + params[8]

    inputs = us[0].shape[1]
    for seed in count():
        n, rng = ORDERS[seed % len(ORDERS)], np.random.default_rng(seed)
        shapes = (n, inputs), (NEURONS, n), (NEURONS, inputs), (NEURONS,), (n, NEURONS), (1, n), (1, inputs), (1,)
        model = Peer(n, 1, inputs, state_fcn=state, output_fcn=output)
        model.init(params=[0.9 * np.eye(n), *(0.1 * rng.normal(size=s) for s in shapes)])
        model.loss(rho_x0=1e-4, rho_th=1e-4)
        model.optimization(adam_epochs=EPOCHS, lbfgs_epochs=EPOCHS, iprint=-1)
        model.fit(*(v if len(us) > 1 else v[0] for v in (ys, us)))

        def run(u: np.ndarray, y: np.ndarray, model=model) -> np.ndarray:
            x0 = model.learn_x0(u[: len(y)], y, RTS_epochs=3, verbosity=False)
            return np.asarray(model.predict(x0, u)[0])

        yield f"{n} states, seed {seed}", run


def polynomials(us: list[np.ndarray], ys: list[np.ndarray]) -> Iterator[tuple[str, Model]]:
    from sysidentpy.basis_function import Polynomial
    from sysidentpy.model_structure_selection import FROLS
    from sysidentpy.parameter_estimation import LeastSquares

    u, y = np.concatenate(us), np.concatenate(ys)
    for degree, lag in product(DEGREES, LAGS):
        taps = list(range(1, lag + 1))
        model = FROLS(
            ylag=lag, xlag=[taps] * u.shape[1] if u.shape[1] > 1 else lag, n_info_values=TERMS,
            estimator=LeastSquares(), basis_function=Polynomial(degree=degree),
        )  # fmt: skip
        model.fit(X=u, y=y)

        def run(u: np.ndarray, y: np.ndarray, model=model, lag=lag) -> np.ndarray:
            return model.predict(X=u, y=y[:lag])

        yield f"degree {degree}, lag {lag}", run


def error(run: Model, runs: list[tuple[np.ndarray, np.ndarray]], settle: int) -> float:
    """RMS of the free runs behind the first samples; inf where one diverges."""
    with np.errstate(all="ignore"):
        errors = [run(u, y[:settle])[settle:] - y[settle:] for u, y in runs]
    found = float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
    return found if np.isfinite(found) else np.inf


KINDS = {"jax-sysid": state_spaces, "sysidentpy": polynomials}


def main() -> None:
    asked = json.loads(Path(sys.argv[1]).read_text())
    signals = {k: [(np.array(u), np.array(y)) for u, y in asked[k]] for k in ("first", "last", "tests")}
    settle, began = max(asked["settle"], max(LAGS)), process_time()
    best = np.inf, "", None
    for name, run in KINDS[asked["package"]](*map(list, zip(*signals["first"], strict=True))):
        try:
            found = error(run, signals["last"], settle)
        except (ValueError, FloatingPointError, OverflowError):  # it diverges
            found = np.inf
        if found < best[0] or best[2] is None:
            best = found, name, run
        if process_time() - began > asked["seconds"]:
            break
    tests = [error(best[2], [test], settle) for test in signals["tests"]]
    print(json.dumps({"chosen": best[1], "held_out": best[0], "tests": tests, "seconds": process_time() - began}))


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    main()
