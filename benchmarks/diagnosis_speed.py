"""How long does a diagnosis take, and how long did it take an earlier state of the code? Both in one run, by turns.

With `--before OTHER/.venv/bin` it keeps both, of which a page is made; ours alone is printed.

A diagnosis is the command `greygate diagnose` in a process of its own, so that its start and what it compiles count.
Both states are given the same folders: four cases of each concealed machine, one of each small machine of another
field, and measured recordings where they are at hand. One that outlasts LIMIT counts as LIMIT.
"""

import json
import subprocess
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from typing import Annotated

from greygate.errors import InputError
from greygate.mismatch.concealed.conceal import RIGS, conceal
from greygate.mismatch.concealed.domains import DOMAINS

from .made import made, store
from .measured_mismatch import make
from .shared import GREYGATE, say, scratch, stopwatch

TAKES = "half an hour"
LIMIT = 600.0  # s
SEED = 9700  # of the concealed cases: no other benchmark has it
KINDS = ("clean", "one", "two", "foreign")
MEASURED = ("emps", "ced", "tanks", "mts", "kuka-2", "crane")
PRIVATE = ("sealed.json", "sealed.json.sha256", "third.csv")


def rigs(folder: Path) -> Iterator[tuple[str, Path]]:
    """Group and folder of every rig."""
    for plant in RIGS:
        for kind in KINDS:
            yield "concealed", hidden(plant, kind, folder)
    for plant in DOMAINS:
        yield "small machines", hidden(plant, "one", folder)
    for name in MEASURED:
        try:
            yield "measured", make(name, folder / name)
        except (InputError, FileNotFoundError) as error:
            say(f"{name}: left out, {error}")


def hidden(plant: str, kind: str, folder: Path) -> Path:
    """A concealed case without its answer."""
    rig = conceal(plant, SEED, folder / f"{plant}_{kind}", kind=kind)
    for name in PRIVATE:
        (rig / name).unlink()
    return rig


def diagnosed(command: Path, rig: Path) -> dict:
    """Seconds of one diagnosis, and what it says: verdict and effects, or its exit code and last words."""
    out = rig / "d.json"
    out.unlink(missing_ok=True)
    watch = stopwatch()
    try:
        ran = subprocess.run([command, "diagnose", rig, "--out", out], capture_output=True, text=True, timeout=LIMIT)
    except subprocess.TimeoutExpired:
        return {"seconds": LIMIT, "says": "not done"}
    seconds = watch(2)
    if ran.returncode not in (0, 1) or not out.exists():
        last = (ran.stderr.strip().splitlines() or [""])[-1]
        return {"seconds": seconds, "says": f"exit code {ran.returncode}: {last[:120]}"}
    said = json.loads(out.read_text(encoding="utf-8"))
    return {"seconds": seconds, "says": " ".join([said["verdict"], *(e["id"] for e in said["effects"])])}


def commit(folder: Path) -> str:
    """The commit of the checkout that `folder` is in."""
    ask = ["git", "-C", folder, "rev-parse", "--short=10", "HEAD"]
    return subprocess.run(ask, capture_output=True, text=True, check=True).stdout.strip()


def summary(rows: list[dict], states: list[str]) -> dict:
    """Median and worst seconds of each group and state, over the rigs that each state explains, and who fails.

    times_faster: of each rig, their median and the least.
    """
    groups = {"all": rows} | {g: [r for r in rows if r["group"] == g] for g in dict.fromkeys(r["group"] for r in rows)}
    found = {}
    for group, every in groups.items():
        part = [row for row in every if not any(failed(row[state]) for state in states)]
        found[group] = {"rigs": len(every), "failed": {s: sum(failed(row[s]) for row in every) for s in states}}
        for state in states if part else ():
            seconds = [row[state]["seconds"] for row in part]
            found[group][state] = {"median": round(median(seconds), 1), "worst": round(max(seconds), 1)}
        if part and "before" in states:
            ratios = [row["before"]["seconds"] / row["now"]["seconds"] for row in part]
            found[group]["times_faster"] = {"median": round(median(ratios), 2), "least": round(min(ratios), 2)}
    return found


def failed(said: dict) -> bool:
    return said["says"].startswith("exit code")


def main(*, before: Annotated[Path | None, "the folder of another checkout's `greygate`"] = None) -> None:
    commands, origin = {"now": Path(GREYGATE)}, made()
    if before:
        commands = {"before": before.absolute() / "greygate"} | commands
        origin |= {"before": commit(before)}
    rows: list[dict] = []
    with scratch() as folder:
        for group, rig in rigs(folder):
            rows.append({"rig": rig.name, "group": group} | {s: diagnosed(c, rig) for s, c in commands.items()})
            say(rows[-1])
            content = {"made": origin, "summary": summary(rows, list(commands)), "rigs": rows}
            if before:  # the page compares: ours alone would not make it
                store("diagnosis_speed", content)
    print(json.dumps(content["summary"], indent=1))
