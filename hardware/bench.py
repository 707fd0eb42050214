"""The cocotb bench: it runs inside the simulator, one test for each design and scenario of a job.

hardware/verify.py writes the job.

The source offers a sample, the sink takes the result; both pause at random. A step costs one awakening of Python, or
a few where somebody pauses. Everything is compared as whole words; a word that differs is taken apart for the message.
"""

import json
import os
import time
from pathlib import Path

import cocotb
import numpy as np
from cocotb.clock import Clock
from cocotb.handle import HierarchyObject, LogicArrayObject, LogicObject
from cocotb.triggers import RisingEdge, Timer
from cocotb.utils import get_sim_time

from greygate.errors import one_line

HALF = 1  # simulator steps in half a clock: stimulus changes at the falling edge, or right after the rising one
CLOCK = 2 * HALF
RECORDING = "recording step wanted"  # handles of a bench that records a waveform
PAUSED = 0.1  # share of the steps before which the source pauses, and of those before which the sink does
PATIENCE = 100_000  # clocks without an answer before the design is said to hang


class Mismatch(AssertionError):
    """The design and the emulator differ, or the design does not answer."""


class UnderTest:
    """One design in the bench: its handles, and how to read what is seen of it: {states, m_axis_tdata}."""

    clk: LogicObject
    rst: LogicObject
    source: LogicArrayObject
    s_tready: LogicObject
    m_tvalid: LogicObject
    m_tready: LogicObject
    seen: LogicArrayObject
    load: LogicObject
    initial: LogicArrayObject

    def __init__(self, dut: HierarchyObject, job: dict, since: int | None):
        self.job = job
        self.since = since  # the step from which on a waveform is recorded
        for name in UnderTest.__annotations__:
            setattr(self, name, getattr(dut, f"{name}_{job['index']}"))
        self.told = {n: getattr(dut, f"{n}_{job['index']}") for n in RECORDING.split()} if job["since"] else {}
        self.rise = RisingEdge(self.m_tvalid)
        self.offered = 0  # toggled with every sample on offer
        self.offer_bit = 1 << (len(self.source) - 1)
        self.ended = -1  # the last step that ended

    async def reset(self, initial: bytes | None) -> None:
        """One clock of reset, then states as given, then everything idle at a falling edge."""
        self.rst.value = 1
        self.m_tready.value = 0
        await Timer(CLOCK)
        self.rst.value = 0
        await Timer(CLOCK)
        await self.ready()
        if initial is not None:
            self.initial.value = int.from_bytes(initial, "little")
            self.load.value = 1
            await Timer(CLOCK)
            self.load.value = 0
            await Timer(CLOCK)

    async def ready(self) -> None:
        """Until s_axis_tready, or the clocks after a reset, say that the initial states stand."""
        if self.job["boot"]:
            await Timer(CLOCK * self.job["boot"])
            return
        for _ in range(PATIENCE):
            if str(self.s_tready.value) == "1":
                return
            await Timer(CLOCK)
        raise Mismatch("after reset: s_axis_tready does not rise")

    def offer(self, sample: bytes) -> None:
        """Put a sample on s_axis_tdata and raise s_axis_tvalid until it is taken (hardware/verify.py)."""
        self.offered ^= self.offer_bit
        self.source.value = self.offered | int.from_bytes(sample, "little")

    def record(self, step: int, expected: str) -> None:
        """Begin the waveform if it is time, and tell it the step that comes and what the emulator has after it."""
        if self.since is not None and step >= self.since:
            for name, value in (("step", step), ("wanted", int(expected, 2)), ("recording", 1)):
                self.told[name].value = value

    def different(self, word: str, expected: str) -> str:
        """Name every element in which a word of bits differs from the expected one."""
        if set(word) - {"0", "1"}:
            return f"undefined bits: {word}"
        got, wanted = (int(w, 2).to_bytes(len(w) // 8, "little") for w in (word, expected))
        found = []
        for what, name, size, start in self.job["seen"]:
            a, b = (int.from_bytes(w[start : start + size], "little", signed=True) for w in (got, wanted))
            if a != b:
                found.append(f"{what} {name} is {a}, the emulator has {b}")
        return "; ".join(found[:8]) + (" ..." if len(found) > 8 else "")


def bit_strings(words: np.ndarray) -> list[str]:
    """Bytes (N, B), the lowest first, as strings of bits the way the simulator gives them."""
    text = (np.unpackbits(words[:, ::-1], axis=1) + ord("0")).tobytes().decode()
    width = 8 * words.shape[1]
    return [text[k : k + width] for k in range(0, len(text), width)]


async def play(design: UnderTest, samples: list[bytes], expected: list[str], steps: int, seed: int) -> float:
    """Run `steps` steps from idle and compare each; returns clocks per step. The first three steps are not paused."""
    rng = np.random.default_rng(seed)
    pauses = np.where(rng.random((2, steps + 1)) < PAUSED, rng.integers(1, 6, (2, steps + 1)), 0)
    pauses[:, :3] = 0
    gaps, stalls = pauses.tolist()
    clocks, before = float("nan"), None

    design.m_tready.value = 1
    design.offer(samples[0])
    for k in range(steps):
        design.record(k, expected[k])
        await design.rise
        design.ended = k
        if k < 3:
            now = get_sim_time()
            clocks, before = (now - before) / CLOCK if before is not None else clocks, now
        word = str(design.seen.value)
        if word != expected[k]:
            raise Mismatch(f"step {k}: {design.different(word, expected[k])}")
        last = k + 1 == steps
        if not last and not gaps[k + 1]:
            design.offer(samples[k + 1])
        if not (last or stalls[k] or stalls[k + 1] or gaps[k + 1]):
            continue
        await Timer(HALF)
        if stalls[k]:
            await Timer(CLOCK * stalls[k])
            if str(design.m_tvalid.value) != "1" or str(design.seen.value) != word:
                raise Mismatch(f"step {k}: the result does not hold still while m_axis_tready is low")
            design.m_tready.value = 1
        await Timer(CLOCK)  # the sink takes the result here
        if stalls[k + 1]:
            design.m_tready.value = 0
        if gaps[k + 1] and not last:
            await Timer(CLOCK * gaps[k + 1])
            design.offer(samples[k + 1])
    return clocks


async def watch(design: UnderTest, verdict: dict) -> None:
    """Fail the test when no step ends for PATIENCE clocks."""
    seen = None
    while seen != design.ended:
        seen = design.ended
        await Timer(CLOCK * PATIENCE)
    where = f"step {seen + 1}" if seen >= 0 else "step 0"
    verdict["mismatch"] = f"{where}: no answer within {PATIENCE} clocks"
    raise Mismatch(verdict["mismatch"])


def make_test(job: dict, scenario: dict, arrays, seed: int, verdicts: list, report: Path):
    """The cocotb test of one design in one scenario: a run cut short by a reset, then the whole of it."""

    async def run(dut: HierarchyObject) -> None:
        key = f"{job['index']}_{scenario['index']}_"
        samples = [row.tobytes() for row in arrays[key + "samples"]]
        expected = bit_strings(arrays[key + "seen"])
        steps = len(samples)
        initial = arrays[key + "initial"][0].tobytes() if scenario["loads"] else None
        state = np.frombuffer(bytes.fromhex(job["initial"]) if initial is None else initial, np.uint8)
        began = bit_strings(state[None])[0] if state.size else ""
        rng = np.random.default_rng(seed)
        since = job["since"][1] if job["since"] and job["since"][0] == scenario["name"] else None
        design = UnderTest(dut, job, since)
        design.source.value = 0
        design.load.value = 0
        clock = Clock(design.clk, CLOCK)
        start = time.perf_counter()
        verdict = {
            "design": job["index"],
            "scenario": scenario["name"],
            "steps": steps,
            "mismatch": "was not finished; see sim.log",
        }
        try:
            clock.start(start_high=False)
            watcher = cocotb.start_soon(watch(design, verdict))
            await Timer(CLOCK)
            for cut in (int(rng.integers(1, max(2, min(steps, 50)))), steps):
                design.ended = -1 - cut  # no step yet; a number that the watcher has not seen
                design.record(0, expected[0])
                await design.reset(initial)
                word = str(design.seen.value)
                if not word.startswith(began):
                    raise Mismatch(f"after reset: {design.different(word, began + word[len(began) :])}")
                verdict["clocks"] = await play(design, samples, expected, cut, int(rng.integers(1 << 31)))
                if cut < steps:  # a further step is under way when the reset comes
                    design.offer(samples[cut])
                    await Timer(CLOCK * int(rng.integers(1, 2 + max(1, int(np.nan_to_num(verdict["clocks"], nan=8))))))
            verdict["mismatch"] = None
        except Mismatch as mismatch:
            verdict["mismatch"] = str(mismatch)
            if since is not None:
                await Timer(CLOCK)  # a waveform shows it
            raise
        finally:
            watcher.cancel()
            clock.stop()
            verdict["seconds"] = time.perf_counter() - start
            verdicts.append(verdict)
            report.write_text(json.dumps(verdicts), encoding="utf-8", newline="\n")

    design, played = one_line(job["name"]), one_line(scenario["name"])  # they stand in XML
    run.__name__ = run.__qualname__ = f"{design}_{played}"
    return cocotb.test(name=f"{design}/{played}")(run)


if "GREYGATE_BENCH" in os.environ:
    _folder = Path(os.environ["GREYGATE_BENCH"])
    _job = json.loads((_folder / "job.json").read_text())
    _arrays = np.load(_folder / "job.npz")
    _verdicts: list[dict] = []
    for _d in _job["designs"]:
        for _s in _d["scenarios"]:
            globals()[f"test_{_d['index']}_{_s['index']}"] = make_test(
                _d, _s, _arrays, _job["seed"], _verdicts, _folder / "verdicts.json"
            )
