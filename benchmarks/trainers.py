"""One trainer on one network from its start weights, in a process of its own: benchmarks/training.py runs it.

python benchmarks/trainers.py TRAINER[,gradient] CASE.npz

Prints a JSON line for each start: {"wall", "cpu", "compile", "iterations", "theta", "note"}, times in seconds. All
minimise the same sum of squares: free run from rest, tansig layers, linear output; theta = W1 by rows, b1, W2, b2, ...
With `,gradient` it only evaluates loss and gradient at the start, as often as there is time; both are `iterations`.
"""

import json
import sys
import time
from dataclasses import dataclass

import numpy as np


@dataclass
class Case:
    """u, y: (N,). inputs, feedback: delays. sizes: regressors, neurons of each layer, 1. goal: MSE. cap: CPU s."""

    u: np.ndarray
    y: np.ndarray
    inputs: list[int]
    feedback: list[int]
    sizes: list[int]
    goal: float
    cap: float
    starts: np.ndarray

    def layers(self, theta):
        """(W, b) of each layer."""
        found, at = [], 0
        for fan_in, size in zip(self.sizes[:-1], self.sizes[1:], strict=True):
            w = theta[at : at + size * fan_in].reshape(size, fan_in)
            at += size * fan_in
            found.append((w, theta[at : at + size]))
            at += size
        return found

    def taps(self):
        """(N, regressors) with the inputs in place and zeros for the outputs."""
        padded = np.concatenate([np.zeros(max(self.inputs)), self.u])
        columns = [padded[max(self.inputs) - d : len(padded) - d] for d in self.inputs]
        return np.column_stack(columns + [np.zeros(len(self.u))] * len(self.feedback))


class Watch:
    """Wall and CPU time since the start, less what is taken out."""

    def __init__(self):
        self.wall, self.cpu = time.perf_counter(), time.process_time()

    def read(self):
        return time.perf_counter() - self.wall, time.process_time() - self.cpu

    def without(self, function):
        """Call the function off the clock."""
        wall, cpu = time.perf_counter(), time.process_time()
        value = function()
        self.wall += time.perf_counter() - wall
        self.cpu += time.process_time() - cpu
        return value


class EndError(Exception):
    """The goal is reached, or the time is over."""


def evaluated(case, function, start):
    """Loss and gradient again and again at the start, until the time is over; one that compiles goes before."""
    function()
    watch, count = Watch(), 0
    while not count or watch.read()[1] < case.cap:
        function()
        count += 1
    wall, cpu = watch.read()
    found = {"iterations": count, "theta": start, "note": f"{count} evaluations"}
    return {"wall": wall, "cpu": cpu, "compile": 0.0, **found}


def greygate(case, start, gradient=False):
    from descent import _Swept

    from greygate.models.families.regression import noe
    from greygate.models.network import Port
    from greygate.models.training.levenberg import train
    from greygate.models.training.record import Record

    network = noe("n", {Port("u"): case.inputs}, Port("y"), case.feedback, case.sizes[1:-1], bypass=False)
    ports = [f"u_z{d}" for d in case.inputs] + [f"y_z{d}" for d in case.feedback]
    names, values = [*[f"hidden{i}" for i in range(1, len(case.sizes) - 1)], "sum"], {}
    for i, (name, (w, b)) in enumerate(zip(names, case.layers(start), strict=True)):
        fed = {p: w[:, [j]] for j, p in enumerate(ports)} if i == 0 else {names[i - 1]: w}
        values |= {f"{name}.{p}": part for p, part in fed.items()} | {f"{name}.bias": b}
    network, record = network.with_parameters(values), Record({"u": case.u}, {"y": case.y})
    if gradient:
        swept = _Swept(network, [record])
        return evaluated(case, lambda: (swept.squares(swept.theta), swept.gradient(swept.theta)), start)
    watch = Watch()
    train(network, [record], epochs=1)
    compiled = watch.read()[0]
    watch = Watch()
    fit = train(network, [record], epochs=100_000, goal=case.goal / 2, seconds=case.cap, tolerance=0.0)
    wall, cpu = watch.read()
    after = fit.network.parameters()
    theta = []
    for i, name in enumerate(names):
        fed = ports if i == 0 else [names[i - 1]]
        theta += [np.hstack([after[f"{name}.{p}"] for p in fed]).ravel(), after[f"{name}.bias"]]
    epochs = len(fit.history) - 1
    note = f"{epochs} epochs, {fit.outcome.name.lower()}"
    return {
        "wall": wall,
        "cpu": cpu,
        "compile": compiled,
        "iterations": epochs,
        "theta": np.concatenate(theta),
        "note": note,
    }


def scipy(case, start):
    from scipy.optimize import least_squares

    taps, lags, count = case.taps(), case.feedback, len(case.y)
    first = len(case.inputs)
    last = {}

    def run(theta):
        *hidden, (wo, bo) = case.layers(theta)
        signals = [np.zeros((count, w.shape[0])) for w, _ in hidden]
        x, y = taps.copy(), np.zeros(count)
        for k in range(count):
            for j, d in enumerate(lags):
                if k >= d:
                    x[k, first + j] = y[k - d]
            h = x[k]
            for (w, b), trace in zip(hidden, signals, strict=True):
                h = trace[k] = np.tanh(w @ h + b)
            y[k] = (wo @ h + bo)[0]
        last.update(theta=theta.copy(), x=x, signals=signals)
        return y

    def residuals(theta):
        with np.errstate(all="ignore"):
            e = np.nan_to_num(run(theta) - case.y, nan=1e6, posinf=1e6, neginf=-1e6)
        mse = float(np.mean(e * e))
        if mse < last.get("best", np.inf):
            last.update(best=mse, at=theta.copy())
        last["runs"] = last.get("runs", 0) + 1
        if mse <= case.goal or watch.read()[1] > case.cap:
            raise EndError
        return e

    def jacobian(theta):
        if not np.array_equal(theta, last["theta"]):
            run(theta)
        last["jacobians"] = last.get("jacobians", 0) + 1
        layers, inputs = case.layers(theta), [last["x"], *last["signals"]]
        parts, delta = [], np.ones((count, 1))
        for i in range(len(layers) - 1, -1, -1):  # all samples at once
            if i < len(layers) - 1:
                delta = delta * (1 - inputs[i + 1] ** 2)
            parts = [(delta[:, :, None] * inputs[i][:, None, :]).reshape(count, -1), delta, *parts]
            delta = delta @ layers[i][0]
        j, gains = np.hstack(parts), delta[:, first:]
        for k in range(count):  # d y(k) = direct + sum_d dy/dy(k-d) d y(k-d)
            for g, d in zip(gains[k], lags, strict=True):
                if k >= d:
                    j[k] += g * j[k - d]
        return j

    watch, note = Watch(), ""
    try:
        options = {"ftol": 1e-15, "xtol": 1e-15, "gtol": 1e-15, "max_nfev": 10**9}
        note = ", " + least_squares(residuals, start, jacobian, method="lm", **options).message
    except EndError:
        pass
    wall, cpu = watch.read()
    found = {"iterations": last.get("jacobians", 0), "theta": last["at"], "note": f"{last['runs']} runs{note}"}
    return {"wall": wall, "cpu": cpu, "compile": 0.0, **found}


def pyrenn(case, start):
    import warnings

    warnings.simplefilter("ignore")  # its source compares with `is` a literal
    import contextlib
    import io

    import pyrenn as package

    net = package.CreateNN([1, *case.sizes[1:]], dIn=case.inputs, dIntern=[], dOut=case.feedback)
    scale = max(np.abs(case.y).max(), 1.0)  # of its own: it divides u and y by their largest value if above 1
    assert np.abs(case.u).max() <= 1.0
    first = len(case.inputs)

    def columns(theta, inward):
        """theta with the weights on and of the output in pyrenn's scale (inward) or in ours."""
        factor = scale if inward else 1 / scale
        layers = [(w.copy(), b.copy()) for w, b in case.layers(theta)]
        layers[0][0][:, first:] *= factor
        layers[-1] = (layers[-1][0] / factor, layers[-1][1] / factor)
        return layers

    net["w"] = np.concatenate([part for w, b in columns(start, True) for part in (w.flatten("F"), b)])
    best, rtrl, error = {"mse": np.inf}, package.RTRL, package.calc_error
    watch = Watch()

    def watched(net, data):
        found = rtrl(net, data)
        if found[1] * scale**2 / len(case.y) < best["mse"]:
            best.update(mse=found[1] * scale**2 / len(case.y), w=net["w"].copy())
        best["epochs"] = best.get("epochs", -1) + 1
        if best["mse"] <= case.goal or watch.read()[1] > case.cap:
            raise EndError
        return found

    def timed(net, data):
        if watch.read()[1] > case.cap:
            raise EndError
        return error(net, data)

    package.RTRL, package.calc_error = watched, timed
    try:
        with contextlib.redirect_stdout(io.StringIO()), np.errstate(all="ignore"):
            package.train_LM(case.u[None], case.y[None], net, k_max=10**6, E_stop=0.0)
    except EndError:
        pass
    finally:
        package.RTRL, package.calc_error = rtrl, error
    wall, cpu = watch.read()
    theta, at = [], 0
    for fan_in, size in zip(case.sizes[:-1], case.sizes[1:], strict=True):
        theta += [best["w"][at : at + size * fan_in].reshape(size, fan_in, order="F").ravel()]
        theta += [best["w"][at + size * fan_in : at + size * (fan_in + 1)]]
        at += size * (fan_in + 1)
    theta = np.concatenate([part for w, b in columns(np.concatenate(theta), False) for part in (w.ravel(), b)])
    found = {"iterations": best["epochs"], "theta": theta, "note": f"{best['epochs']} epochs"}
    return {"wall": wall, "cpu": cpu, "compile": 0.0, **found}


def jax_sysid(case, start, gradient=False):
    """L-BFGS alone, as its documentation has it for recurrent networks; a thousand steps of Adam first cost time."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import jax.numpy as jnp
    from jax_sysid import _model
    from jax_sysid.models import Model

    lags, older = max(case.feedback), [d for d in case.inputs if d > 1]  # u(k) is the tap of delay 1 of y(k + 1)
    nx, count = lags + len(older), len(case.y)

    def state(x, u, params):
        now = jnp.concatenate([u, x[lags:]]) if older else u
        h = jnp.concatenate([now, x[jnp.array([d - 1 for d in case.feedback])]])
        for w, b in zip(params[0:-2:2], params[1:-2:2], strict=True):
            h = jnp.tanh(w @ h + b)
        y = params[-2] @ h + params[-1]
        return jnp.concatenate([y, x[: lags - 1], now[: len(older)]])

    assert case.inputs in ([1], [1, 2])
    model = Model(nx, 1, 1, state_fcn=state, y_in_x=True)
    model.init(params=[part for pair in case.layers(start) for part in pair], x0=np.zeros(nx))
    model.loss(rho_x0=0.0, rho_th=0.0, train_x0=False)
    model.optimization(adam_epochs=0, lbfgs_epochs=10**7, iprint=-1)
    watch, seen = Watch(), {"iterations": 0, "mse": np.inf}

    def callback(iterations, iprint, loss):
        def watched(z):
            if gradient:
                both = jax.jit(jax.value_and_grad(loss))
                seen["evaluated"] = evaluated(case, lambda: jax.block_until_ready(both(z)), start)
                raise StopIteration
            if not seen["iterations"]:
                seen["first"] = watch.read()
            seen["iterations"] += 1
            mse = watch.without(lambda: float(loss(z))) * (count + 1) / count
            if mse < seen["mse"]:
                seen.update(mse=mse, z=z)
            seen["last"] = watch.read()
            if mse <= case.goal or seen["last"][1] > case.cap:
                raise StopIteration

        return watched, None

    kept, _model.lbfgs_callback = _model.lbfgs_callback, callback
    # one sample of rest before the record, so that its first output is predicted too
    u, y = np.concatenate([[0.0], case.u]), np.concatenate([[0.0], case.y])
    try:
        model.fit(y[:, None], u[:, None])
    finally:
        _model.lbfgs_callback = kept
    if gradient:
        return seen["evaluated"]
    share = 1 - 1 / max(seen["iterations"], 2)  # the first iteration compiles: the others tell what it takes itself
    wall, cpu = ((last - first) / share for last, first in zip(seen["last"], seen["first"], strict=True))
    theta = np.concatenate([np.asarray(part).ravel() for part in seen["z"]])
    found = {"iterations": seen["iterations"], "theta": theta, "note": f"{seen['iterations']} iterations"}
    return {"wall": wall, "cpu": cpu, "compile": seen["first"][0], **found}


if __name__ == "__main__":
    with np.load(sys.argv[2]) as data:
        case = Case(**{n: v if n in ("u", "y", "starts") else v.tolist() for n, v in data.items()})
    name, _, gradient = sys.argv[1].partition(",")
    trainer = {"greygate": greygate, "scipy": scipy, "pyrenn": pyrenn, "jax-sysid": jax_sysid}[name]
    for start in case.starts:
        found = trainer(case, start, True) if gradient else trainer(case, start)
        print(json.dumps(found | {"theta": found["theta"].tolist()}), flush=True)
