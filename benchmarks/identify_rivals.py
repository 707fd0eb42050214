"""Beside `identify`: a torch network of equal size, thirty networks as a person would tune them, and peers.

torch: `torch.nn.RNN` (tanh) with a linear output, of as many weights as what `identify` chose (results/identify.json)
or a few more, in float64 by Adam through windows, for the minute that `identify` has. Its weights are those of the
lowest error on the last quarter of each recording, which it does not train on; it has as many first samples of a test
to settle in. tuned: thirty draws of form, neurons, order, delay, stride, decay and seed, each trained to the end on
three quarters of each recording; the best on the last quarter is fitted to everything. The lowest test error of the
thirty is given too: no person could choose by it. jax-sysid, sysidentpy: identify_peer.py.
"""

import json
import math
import subprocess
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from time import monotonic
from typing import Annotated

import numpy as np
import torch

from greygate.identify.fitted import begun, refitted, seeded, thinned
from greygate.identify.halving import EPOCHS, LADDER, ORDERS, reach
from greygate.identify.ladder import FORMS, Orders
from greygate.identify.looking import look
from greygate.identify.task import Task, started, task
from greygate.identify.tried import DECAY, STRONG, Model, pooled
from greygate.models.training.record import Record

from .identify import JOBS, NAMES, SECONDS, judged, recorded
from .made import keep, stored
from .shared import PEERS, say, scratch

TAKES = "half an hour"
RATE, WINDOW, TOGETHER = 1e-2, 200, 64  # of Adam; judged samples of a window; windows of a step
DRAWS = 30
LARGEST = 20000  # samples that a tuned network is trained on


def posed(name: str) -> tuple[Task, dict[str, Record], dict]:
    """The task of the training runs, its tests, and what is seen of the first run."""
    given, inputs, output, tests = recorded(name)
    asked = task(given, inputs, output)
    return asked, {n: judged(asked, r) for n, r in tests.items()}, look(next(iter(given.values())), inputs, output)


def parted(asked: Task) -> tuple[list[Record], list[Record]]:
    """Three quarters of each recording, and its last one."""
    ends = {n: 3 * len(r) // 4 for n, r in asked.records.items()}
    first = [started(r.cut(0, ends[n], skip=0), asked.output) for n, r in asked.records.items()]
    last = [started(r.cut(ends[n], len(r), skip=asked.settle), asked.output) for n, r in asked.records.items()]
    return first, last


# ---- torch


class Net(torch.nn.Module):
    def __init__(self, inputs: int, hidden: int):
        super().__init__()
        self.loop = torch.nn.RNN(inputs, hidden, batch_first=True, dtype=torch.float64)
        self.read = torch.nn.Linear(hidden, 1, dtype=torch.float64)

    def forward(self, u: torch.Tensor) -> torch.Tensor:
        return self.read(self.loop(u)[0])[..., 0]


def rival(name: str) -> dict:
    asked, tests, _ = posed(name)
    weights = stored("identify")[name]["chosen"]["parameters"]
    torch.manual_seed(0)
    torch.set_num_threads(JOBS)
    net = next(n for n in (Net(len(asked.inputs), h) for h in range(1, 200)) if size(n) >= weights)
    first, last = parted(asked)
    windows = cut(asked, first)
    optimizer = torch.optim.Adam(net.parameters(), RATE)
    rng, began, best, steps = np.random.default_rng(0), monotonic(), (math.inf, net.state_dict()), 0
    next_look = 0.0
    while (passed := monotonic() - began) < SECONDS:
        chosen = torch.as_tensor(rng.permutation(len(windows[0]))[:TOGETHER])
        optimizer.zero_grad()
        errors = (net(windows[0][chosen]) - windows[1][chosen])[:, asked.settle :]
        torch.mean(errors**2).backward()
        torch.nn.utils.clip_grad_norm_(net.parameters(), 1.0)
        optimizer.step()
        steps += 1
        if passed >= next_look:
            next_look = passed + SECONDS / 100
            if (error := free_run(net, asked, last)) < best[0]:
                best = error, {n: v.clone() for n, v in net.state_dict().items()}
    net.load_state_dict(best[1])
    return {
        "weights": size(net),
        "steps": steps,
        "held_out": best[0],
        "seconds": monotonic() - began,
        "test": {n: free_run(net, asked, [r]) for n, r in tests.items()},
    }


def size(net: Net) -> int:
    return sum(p.numel() for p in net.parameters())


def cut(asked: Task, records: Sequence[Record]) -> tuple[torch.Tensor, torch.Tensor]:
    """Overlapping windows (count, samples) of inputs and output, normalised."""
    length = min(asked.settle + WINDOW, *(len(r) for r in records))
    found = [
        tuple(v[at : at + length] for v in signals(asked, r))
        for r in records
        for at in range(0, len(r) - length + 1, WINDOW // 2)
    ]
    return torch.stack([f[0] for f in found]), torch.stack([f[1] for f in found])


def signals(asked: Task, record: Record) -> tuple[torch.Tensor, torch.Tensor]:
    u = np.stack([p.normalised(record.inputs[p.name]) for p in asked.inputs], axis=-1)
    return torch.as_tensor(u), torch.as_tensor(asked.output.normalised(record.targets[asked.output.name]))


def free_run(net: Net, asked: Task, records: Sequence[Record]) -> float:
    """RMS of a free run in the output's unit."""
    errors = []
    with torch.no_grad():
        for record in records:
            u, y = signals(asked, record)
            errors.append((net(u[None])[0] - y).numpy()[record.skip :] * asked.output.scale)
    return float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))


# ---- tuned by hand


def tuned(name: str) -> dict:
    asked, tests, seen = posed(name)
    first, last = parted(asked)
    delays, strides = reach(asked, [seen])
    rng, began = np.random.default_rng(0), monotonic()
    tried = []

    def fit(model: Model, seed: int, records: Sequence[Record]):
        pieces = thinned(records, LARGEST, asked)
        line = refitted(model.line, asked, begun(model.line, asked, pieces), pieces, LADDER.epochs, math.inf)
        network = seeded(asked, model, line.network, pieces, seed)
        return refitted(model, asked, network or line.network, pieces, EPOCHS, math.inf).network

    def error(network, records: Sequence[Record]) -> float:
        return pooled([asked.errors(network, r) for r in records])

    for draw in range(DRAWS):
        model = Model(
            FORMS[rng.integers(len(FORMS))],
            Orders(int(rng.choice(ORDERS)), delays[rng.integers(len(delays))], int(rng.choice(strides))),
            float(rng.choice([DECAY, STRONG])),
        )
        network = fit(model, draw, first)
        row = {"model": model.name, "held_out": error(network, last)}
        row |= {"test": {n: error(network, [r]) for n, r in tests.items()}}
        tried.append((row, model, draw))
        say(name, draw, row, f"{monotonic() - began:.0f} s")
    best, model, seed = min(tried, key=lambda t: t[0]["held_out"])
    network = fit(model, seed, list(asked.records.values()))
    return {
        "chosen": best["model"],
        "held_out": best["held_out"],
        "test": {n: error(network, [r]) for n, r in tests.items()},
        "lowest_test": {n: min(t[0]["test"][n] for t in tried) for n in tests},
        "seconds": monotonic() - began,
    }


# ---- peers


def peer(package: str, name: str) -> dict:
    """What a peer finds for the same recordings in the same minute, in the interpreter of `make peers`."""
    asked, tests, _ = posed(name)

    def listed(records: Sequence[Record]) -> list:
        return [[u.tolist(), y[:, None].tolist()] for u, y in (signals(asked, r) for r in records)]

    first, last = parted(asked)
    told = {"first": listed(first), "last": listed(last), "tests": listed(list(tests.values()))}
    with scratch() as folder:
        file = folder / "asked.json"
        file.write_text(json.dumps({**told, "package": package, "settle": asked.settle, "seconds": SECONDS}))
        script = Path(__file__).with_name("identify_peer.py")
        done = subprocess.run([str(PEERS), str(script), str(file)], capture_output=True, text=True, check=True)
    found = json.loads(done.stdout.splitlines()[-1])
    scale = asked.output.scale
    found["tests"] = {n: e * scale for n, e in zip(tests, found["tests"], strict=True)}
    return found | {"held_out": found["held_out"] * scale}


KINDS = {"torch": rival, "tuned": tuned, **{n: partial(peer, n) for n in ("jax-sysid", "sysidentpy")}}


def main(kind: Annotated[str, KINDS], *names: Annotated[str, NAMES]) -> None:
    for name in names or NAMES:
        found = KINDS[kind](name)
        keep("identify_rivals", f"{kind} {name}", found, kind, name)
        print(kind, name, found, flush=True)
