"""Runs every command of diagnosis over random valid rigs: no traceback, no hang.

Each rig is diagnosed (with its page), simulated by its data sheet and with the diagnosis, and asked for what it can
tell apart. Every fiftieth is a concealed case of a known machine, which is concealed and revealed too, and augmented
where its network has a module for the effect. A command that ends with exit code 2 is counted with what it says.
"""

import contextlib
import io
import json
import signal
import sys
import time
import traceback
from collections import Counter
from pathlib import Path
from typing import Annotated

from generated_rigs import make
from joblib import Parallel, delayed

from .made import store
from .shared import Jobs, say, scratch, stopwatch

TAKES = "ten minutes"
HANG = 600.0  # s, after which a command hangs
CONCEALED = 50  # one rig in so many is a concealed case
MACHINES = {"cable_drum": "speed_slip", "belt_drive": "scale_error"}  # with the shortest diagnoses: what is concealed
AUGMENTED = {"cable_drum"}  # whose network has a module for it


class HangError(BaseException):
    """A command takes too long; no `except Exception` of the product holds it up."""


def _hang(number: int, frame: object) -> None:
    raise HangError


def called(*arguments: object) -> dict:
    """The command in this process: exit code (None for a traceback or a hang), stderr's last line, seconds."""
    from greygate import cli

    signal.signal(signal.SIGALRM, _hang)
    signal.alarm(int(HANG))
    before, sys.argv = sys.argv, ["greygate", *map(str, arguments)]
    out, err, began, code, trace = io.StringIO(), io.StringIO(), time.perf_counter(), None, ""
    try:
        with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
            cli.run()
    except SystemExit as stopped:
        code = int(stopped.code or 0)
    except (Exception, HangError):
        trace = traceback.format_exc(limit=-3)
    finally:
        signal.alarm(0)
        sys.argv = before
    said = (err.getvalue().strip().splitlines() or [""])[-1]
    return {"code": code, "said": said if code else "", "traceback": trace, "seconds": time.perf_counter() - began}


def strict(path: Path) -> str:
    """What is wrong with a JSON file for a strict reader; empty where nothing is."""

    def refuse(name: str) -> None:
        raise ValueError(f"{name} is no JSON")

    try:
        json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)
    except ValueError as error:
        return str(error)
    return ""


def generated(seed: int) -> dict:
    """Every command on one random rig."""
    with scratch() as folder:
        rig = folder / f"rig{seed}"
        drawn = make(seed, rig)
        return {**drawn, "commands": _commands(rig)}


def concealed(seed: int) -> dict:
    """Every command on one concealed case."""
    name = list(MACHINES)[seed // CONCEALED % len(MACHINES)]
    what = ("--kind", "one", "--effect", MACHINES[name])
    with scratch() as folder:
        rig = folder / name
        ran = {"conceal": called("dev", "conceal", name, "--seed", seed, *what, "--out", rig)}
        ran |= _commands(rig)
        ran["reveal"] = called("dev", "reveal", rig, "--diagnosis", rig / "d.json")
        if name in AUGMENTED:
            ran["augment"] = called("augment", rig, "--diagnosis", rig / "d.json", "--out", rig / "augmented")
        return {"seed": seed, "kind": name, "traits": ["concealed case"], "commands": ran}


def _commands(rig: Path) -> dict[str, dict]:
    held = rig / "holdout.csv"
    ran = {"diagnose": called("diagnose", rig, "--out", rig / "d.json", "--html", rig / "page.html")}
    ran["simulate"] = called("simulate", rig, rig / "identify.csv", "--out", rig / "s.csv")
    if (rig / "d.json").exists():
        found = json.loads((rig / "d.json").read_text(encoding="utf-8"))
        ran["diagnose"] |= {"verdict": found["verdict"], "json": strict(rig / "d.json")}
        recording = held if held.exists() else rig / "identify.csv"
        options = ("--diagnosis", rig / "d.json", "--out", rig / "c.csv")
        ran["corrected"] = called("simulate", rig, recording, *options)
        ran["next"] = called("next", rig, "--diagnosis", rig / "d.json", "--out", rig / "next.csv")
    ran["isolability"] = called("isolability", rig)
    return ran


def one(seed: int) -> dict:
    found = (concealed if seed % CONCEALED == CONCEALED - 1 else generated)(seed)
    codes = " ".join(f"{name} {c['code']}" for name, c in found["commands"].items())
    say(f"{seed:4} {found['kind']:12} {codes}")
    return found


def summary(found: list[dict]) -> dict:
    """Counts over all rigs, and what to look at."""
    ran = [(rig, name, c) for rig in found for name, c in rig["commands"].items()]
    seconds = sorted(c["seconds"] for _, name, c in ran if name == "diagnose")
    return {
        "rigs": len(found),
        "commands": len(ran),
        "tracebacks": sum(c["code"] is None and "HangError" not in c["traceback"] for _, _, c in ran),
        "hangs": sum("HangError" in c["traceback"] for _, _, c in ran),
        "not_json": sum(bool(c.get("json")) for _, _, c in ran),
        "exit_codes": {
            command: dict(Counter(str(c["code"]) for _, name, c in ran if name == command))
            for command in dict.fromkeys(name for _, name, _ in ran)
        },
        "verdicts": dict(Counter(c.get("verdict", "none") for _, name, c in ran if name == "diagnose")),
        "diagnose_seconds": {"median": round(seconds[len(seconds) // 2], 1), "worst": round(seconds[-1], 1)},
        "kinds": dict(Counter(rig["kind"] for rig in found)),
        "traits": dict(sorted(Counter(t for rig in found for t in rig["traits"]).items())),
        "said_by_exit_code_2": dict(Counter(_general(c["said"]) for _, _, c in ran if c["code"] == 2)),
        "seen": [
            {"seed": rig["seed"], "command": name, "traceback": c["traceback"], "json": c.get("json", "")}
            for rig, name, c in ran
            if c["code"] is None or c.get("json")
        ],
    }


def _general(said: str) -> str:
    """A message without the folder of its rig."""
    return " ".join(word for word in said.split() if "/" not in word)


def main(
    *, rigs: int = 200, first: Annotated[int, "first seed; the tests have 0 to 14"] = 1000, jobs: Jobs = 2
) -> None:
    watch, found = stopwatch(), []
    tasks = (delayed(one)(first + k) for k in range(rigs))
    for rig in Parallel(jobs, return_as="generator_unordered")(tasks):
        found.append(rig)
        content = {**summary(found), "wall_seconds": round(watch())}
        store("generated_rigs", content)
    print(json.dumps({k: v for k, v in content.items() if k not in ("traits", "kinds")}, indent=1))
