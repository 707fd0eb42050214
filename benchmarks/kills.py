"""Every long command is ended at random times, by SIGTERM and by SIGKILL: what is left, and who still runs?

Every command is a part. After each kill it is asked: are the results whole, those from before or
those from after; is a process of the command alive after 5 s; was there a traceback; and, after every RERUN-th, does
the command work again and leave no strays? Half of the kills find an earlier result in place.
"""

import json
import os
import random
import shutil
import signal
import subprocess
import time
from pathlib import Path
from typing import Annotated

from networks import delay_line

from greygate.files import OURS
from greygate.mismatch.concealed.conceal import conceal

from .made import keep
from .shared import GREYGATE, scratch, stopwatch

TAKES = "hours"
THREADS = "all"
MARK = "GREYGATE_KILLS"  # a variable that every process of a command has
SOON = 5.0  # s
SAMPLES = 2001  # lines of a recording
COMMANDS = {  # name -> (words; {at} is the folder of the inputs, what it writes)
    "identify": ("identify {at}/a.csv --input u --output y --seconds 20 --jobs 2 --out found", ["found"]),
    "diagnose": ("diagnose {at}/fast {at}/clean --jobs 2 --out pages --html pages", ["pages"]),
    "train": ("train {at}/line.toml {at}/a.csv --epochs 20 --out learnt", ["learnt"]),
    "compile": ("compile {at}/line.toml {at}/a.csv --out built", ["built"]),
    "compile --device": (
        "explore {at}/line.toml {at}/a.csv --target up5k --max-error 5% --jobs 2 --out built", ["built"]
    ),
    "verify": ("verify build", ["build"]),
    "synthesize": ("synthesize build --target ice40", ["build"]),
    "report": ("report build --out report.html", ["report.html", "report.json"]),
    "emulate": ("emulate build {at}/a.csv --out told.csv", ["told.csv"]),
    "simulate": ("simulate {at}/fast {at}/fast/identify.csv --out told.csv", ["told.csv"]),
    "export fmu": ("export fmu {at}/fast --out plant.fmu", ["plant.fmu"]),
    "validate": ("validate {at}/line.toml {at}/a.csv --html page.html", ["page.html", "page.json"]),
}  # fmt: skip


def inputs(at: Path) -> None:
    """Write small inputs of all commands."""
    rows, y, u = [], [0.0, 0.0], 0.0
    draw = random.Random(1)
    for k in range(SAMPLES):
        u = draw.choice((-1.0, 1.0)) if k % 9 == 0 else u
        y.append(0.7 * y[-1] - 0.1 * y[-2] + 0.3 * u)
        rows.append(f"{k * 1e-3:.3f},{u},{y[-1] + 0.01 * draw.gauss(0, 1):.6f}\n")
    at.mkdir()
    (at / "a.csv").write_text("t_s,u_V,y_m\n" + "".join(rows))
    delay_line().save(at / "line")
    for name, kind in (("fast", {"effect": "speed_slip", "kind": "one"}), ("clean", {"kind": "clean"})):
        conceal("cable_drum", 3, at / name, **kind)
        for table in (at / name).glob("*.csv"):
            table.write_text("".join(table.read_text().splitlines(keepends=True)[:SAMPLES]))
    done = subprocess.run([GREYGATE, *words("compile", at)[:-1], str(at / "build")], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def words(command: str, at: Path) -> list[str]:
    return COMMANDS[command][0].format(at=at).split()


def state(folder: Path, targets: list[str]) -> dict[str, bytes]:
    """Contents of the results in a folder, by path; what a writer keeps beside them meanwhile is none."""
    found = [p for t in targets for p in ([folder / t] if (folder / t).is_file() else (folder / t).rglob("*"))]
    return {
        p.relative_to(folder).as_posix(): p.read_bytes()
        for p in found
        if p.is_file() and not OURS.fullmatch(p.relative_to(folder).as_posix()) and "simulation" not in p.parts
        if not any(part.endswith((".greygate-new", ".greygate-old")) for part in p.parts) and p.suffix != ".checkpoint"
    }


def whole(command: str, found: dict[str, bytes], before: dict[str, bytes], after: dict[str, bytes]) -> bool:
    """Whether results are those from before, or complete; of several rigs each has its own."""
    for name, content in found.items():
        if name.endswith(".json"):
            try:
                json.loads(content)
            except ValueError:
                return False
    if command == "diagnose":
        rigs = {name.rpartition(".")[0] for name in found}
        return all({f"{rig}.json", f"{rig}.html"} <= set(found) for rig in rigs) and set(found) <= set(after)
    return found == before or set(found) == set(after)


def alive(mark: str) -> list[str]:
    """Commands of the processes that carry the mark."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            if f"{MARK}={mark}".encode() in (process / "environ").read_bytes().split(b"\0"):
                found.append((process / "cmdline").read_bytes().replace(b"\0", b" ").decode(errors="replace")[:200])
        except OSError:
            pass
    return found


def measured(command: str, at: Path, place: Path, times: int, rerun: int, draw: random.Random) -> dict:
    """End the command so many times and judge what is left."""
    targets = COMMANDS[command][1]

    def fresh(old: Path | None) -> Path:
        folder = place / "here"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        shutil.copytree(at / "build", folder / "build")
        (folder / "pages").mkdir()
        (folder / "learnt").mkdir()
        for target in targets if old else ():
            if (old / target).is_dir():
                shutil.copytree(old / target, folder / target, dirs_exist_ok=True)
            elif (old / target).exists():
                shutil.copy(old / target, folder / target)
        return folder

    def call(folder: Path) -> tuple[int, str, float]:
        watch = stopwatch()
        done = subprocess.run([GREYGATE, *words(command, at)], cwd=folder, capture_output=True, text=True)
        return done.returncode, done.stderr, watch()

    folder = fresh(None)
    code, said, _ = call(folder)
    assert code in (0, 1), said
    after = state(folder, targets)
    shutil.copytree(folder, place / "old", dirs_exist_ok=True)
    lasts = call(fresh(None))[2]  # now that everything is compiled
    found = {"kills": 0, "ended_before": 0, "not_whole": 0, "orphans": 0, "tracebacks": 0, "reruns": 0, "failed": 0}
    wrong: list[str] = []
    for k in range(times):
        how = (signal.SIGTERM, signal.SIGKILL)[k % 2]
        folder = fresh(place / "old" if k // 2 % 2 else None)
        before, mark = state(folder, targets), f"{command}-{k}-{time.monotonic_ns()}".replace(" ", "")
        environment, at_s = os.environ | {MARK: mark}, draw.uniform(0.0, 1.1 * lasts)
        process = subprocess.Popen(
            [GREYGATE, *words(command, at)], cwd=folder, env=environment, start_new_session=True, text=True,
            stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
        )  # fmt: skip
        time.sleep(at_s)
        found["kills"] += 1
        found["ended_before"] += process.poll() is not None
        process.send_signal(how)
        struck = time.monotonic()
        process.wait()
        while (left := alive(mark)) and time.monotonic() < struck + SOON:
            time.sleep(0.1)
        error = process.stderr.read() if not left else ""
        process.stderr.close()
        where = f"{how.name} after {at_s:.2f} of {lasts:.2f} s"
        faults = {"orphans": bool(left), "tracebacks": "Traceback" in error}
        faults["not_whole"] = not whole(command, state(folder, targets), before, after)
        if k % rerun == 0:
            code, said, _ = call(folder)
            strays = [p.name for p in folder.rglob(".*") if OURS.fullmatch(p.name)]
            found["reruns"] += 1
            faults["failed"] = code not in (0, 1) or set(state(folder, targets)) != set(after) or bool(strays)
            error += said if faults["failed"] else ""
        for name, is_wrong in faults.items():
            found[name] += is_wrong
            if is_wrong:
                wrong.append(f"{where}: {name}: {' | '.join(left)} {error[-400:]}".strip())
    return found | {"seconds": round(lasts, 2), "wrong": wrong}


def main(
    *commands: Annotated[str, COMMANDS],
    times: int = 100,
    rerun: Annotated[int, "run again after every so-manieth kill"] = 1,
    seed: int = 1,
) -> None:
    with scratch("kills-") as folder:
        inputs(folder / "in")
        for command in commands or COMMANDS:
            place = folder / command.replace(" ", "_")
            place.mkdir()
            found = measured(command, folder / "in", place, times, rerun, random.Random(seed))
            keep("kills", command, {"seed": seed, "rerun": rerun, **found})
            print(command, json.dumps(found), flush=True)
