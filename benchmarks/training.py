"""Time to the thesis's training error in free run, beside scipy, pyrenn and jax-sysid.

Every trainer starts from the same NARX weights of the same network (Nguyen-Widrow, then series-parallel training to
LOOSE times the goal), reads the same record, and has one thread. CPU seconds; a machine that does other things distorts
wall time. Compilation is reported apart. The mean squared error of what a trainer returns is computed here, by
`Network.run`.
"""

import json
import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from greygate.machines.benchmark_systems.plant import b1, b1_input, b2, b2_input
from greygate.models.families.blocks import nguyen_widrow
from greygate.models.families.regression import noe
from greygate.models.network import Network, Port
from greygate.models.training.levenberg import train
from greygate.models.training.record import Record

from . import shared
from .shared import scratch

TAKES = "twenty minutes"
LOOSE = 100  # the NARX start's error over the goal
HERE = Path(__file__).parent
TRAINERS = ("greygate", "scipy", "pyrenn", "jax-sysid")
OURS = ("greygate", "scipy")  # of the environment that runs this
ONE_THREAD = {
    "OMP_NUM_THREADS": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "NUMBA_NUM_THREADS": "1",
    "XLA_FLAGS": "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1",
    "JAX_PLATFORMS": "cpu",
}


@dataclass(frozen=True)
class Case:
    u: np.ndarray
    y: np.ndarray
    inputs: tuple[int, ...]
    feedback: tuple[int, ...]
    hidden: tuple[int, ...]
    goal: float  # MSE of the thesis's NOE (tables 3.3 and 3.4)

    def network(self, seed: int) -> Network:
        taps = {Port("u"): self.inputs}
        return nguyen_widrow(noe("n", taps, Port("y"), self.feedback, self.hidden, bypass=False), seed)

    @property
    def record(self) -> Record:
        return Record({"u": self.u}, {"y": self.y})

    @property
    def sizes(self) -> list[int]:
        return [len(self.inputs) + len(self.feedback), *self.hidden, 1]

    def vector(self, network: Network) -> np.ndarray:
        """Weights as `trainers.py` orders them: of each layer the matrix by rows, then the bias."""
        found = []
        for layer in network.flatten().modules.values():
            found += [np.hstack(list(layer.weights.values())).ravel(), layer.bias]
        return np.concatenate(found)

    def with_vector(self, theta: np.ndarray) -> Network:
        network, values, at = self.network(0), {}, 0
        for name, layer in network.modules.items():
            widths = [w.shape[1] for w in layer.weights.values()]
            w = theta[at : at + layer.size * sum(widths)].reshape(layer.size, -1)
            at += w.size + layer.size
            parts = np.split(w, np.cumsum(widths)[:-1], axis=1)
            values |= {f"{name}.{p}": part for p, part in zip(layer.weights, parts, strict=True)}
            values[f"{name}.bias"] = theta[at - layer.size : at]
        return network.with_parameters(values)


def cases() -> dict[str, Case]:
    u1, u2 = b1_input(), b2_input()
    return {
        "B1-10": Case(u1, b1(u1), (1,), (1, 2), (10,), 1.38e-6),
        "B1-30": Case(u1, b1(u1), (1,), (1, 2), (30,), 7.4e-10),
        "B2": Case(u2, b2(u2), (1, 2), (1, 2, 3), (20, 10), 8.57e-8),
    }


def narx_starts(case: Case, count: int) -> list[tuple[Network, float]]:
    """The first `count` seeds' NARX fits, and the seconds that each took."""
    fits = [
        train(case.network(seed), [case.record], teacher=True, epochs=1000, goal=LOOSE * case.goal / 2)
        for seed in range(count)
    ]
    return [(fit.network, fit.seconds) for fit in fits]


def free_run_error(case: Case, network: Network) -> float:
    return float(np.mean((network.run({"u": case.u})["y"] - case.y) ** 2))


def run(trainer: str, case: Case, starts: list[Network], peers: Path, cap: float, cache: Path) -> list[dict]:
    """What the trainer prints for each start, with the error of its weights as computed here."""
    python = sys.executable if trainer in OURS else peers
    with scratch() as folder:
        path = folder / "case.npz"
        weights = np.array([case.vector(n) for n in starts])
        np.savez(
            path,
            u=case.u, y=case.y, inputs=case.inputs, feedback=case.feedback, sizes=case.sizes,
            goal=case.goal, cap=cap, starts=weights,
        )  # fmt: skip
        done = subprocess.run(
            [python, str(HERE / "trainers.py"), trainer, str(path)],
            env=os.environ | ONE_THREAD | {"NUMBA_CACHE_DIR": str(cache)},
            capture_output=True,
            text=True,
        )
    lines = [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    if done.returncode or len(lines) != len(starts):
        print(f"{trainer}: {len(lines)} of {len(starts)} starts came back; {done.stderr[-2000:]}")
    for line in lines:
        line["mse"] = free_run_error(case, case.with_vector(np.array(line["theta"])))
    return lines


def line_of(trainer: str, case: Case, found: list[dict], reference: float | None, cap: float) -> tuple[str, float]:
    """A row of the table, and the median CPU time (inf if the median start does not reach the goal)."""
    reached = [f["mse"] <= case.goal * (1 + 1e-6) for f in found]
    median = float(np.median([f["cpu"] if r else np.inf for f, r in zip(found, reached, strict=True)]))
    wall = float(np.median([f["wall"] for f in found]))
    shown = f"{median:9.3f}" if np.isfinite(median) else f"  > {cap:g}"
    times = "" if reference is None else f"{(median if np.isfinite(median) else cap) / reference:8.1f}x"
    times = times if np.isfinite(median) or not times else f"> {times.strip()}"
    mse = float(np.median([f["mse"] for f in found]))
    notes = "; ".join(f["note"] for f in found)
    hits = f"{sum(reached)}/{len(found)}"
    return (
        f"{trainer:10} {shown:>10} {wall:9.3f} {found[0]['compile']:8.2f} {hits:>5} {mse:10.2e} {times:>10}  {notes}",
        median,
    )


def main(
    *names: str,
    starts: int = 3,
    cap: float = 120.0,
    peers: shared.Peers = shared.PEERS,
    trainers: Sequence[str] = TRAINERS,
) -> None:
    with scratch() as cache:
        for name in names or cases():
            case = cases()[name]
            fits = narx_starts(case, starts)
            networks = [network for network, _ in fits]
            weights = sum(a * b + b for a, b in zip(case.sizes[:-1], case.sizes[1:], strict=True))
            before = ", ".join(f"{free_run_error(case, n):.1e}" for n in networks)
            narx = float(np.median([seconds for _, seconds in fits]))
            print(f"\n{name}: {weights} weights, {len(case.u)} samples, free-run MSE {before} -> {case.goal:.3g}")
            print(f"NARX start by greygate: {narx:.2f} s (median)")
            print(f"{'trainer':10} {'CPU s':>10} {'wall s':>9} {'compile':>8} {'hit':>5} {'MSE':>10} {'against':>10}")
            reference = None
            for trainer in trainers:
                found = run(trainer, case, networks, peers, cap, cache)
                if not found:
                    continue
                row, median = line_of(trainer, case, found, reference, cap)
                reference = median if reference is None else reference
                print(row, flush=True)
