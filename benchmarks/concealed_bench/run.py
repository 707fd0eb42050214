"""Runs a tool on every case of a split. A tool is a command that is called twice for each case:

    COMMAND explain CASE ANSWER                 reads CASE/rig.toml, identify.csv ...; writes ANSWER/answer.json
    COMMAND predict CASE ANSWER RECORDING.csv   writes ANSWER/predicted.csv: t and the predicted channels

It sees the recording only when its answer is written, and it may keep files of its own in ANSWER in between.
"""

import json
import shlex
import shutil
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed, wait
from pathlib import Path
from threading import Event

from greygate import children
from greygate.contents import contents
from greygate.errors import InputError
from greygate.progress import Progress, silent

from . import baselines
from .answer import FILE, PREDICTED, RUN
from .baselines import MODELS
from .make import committed

OURS = "greygate"
BASELINES = ("nominal", "calibrated", *MODELS)
TOOLS = {OURS: children.python(str(Path(__file__).with_name("entrant.py")))}
LONGEST = 1e6  # s: waiting for more is waiting for ever
LOOKS = 0.1  # s between two looks whether a tool has ended
SAID = 400  # characters of what a tool that fails has said last


Call = Callable[[list[str], float], dict]  # arguments of a tool, limit -> seconds, code, error


def tool_of(tool: str) -> Call:
    """A baseline, our own tool, or a command as a shell would split it. Raises InputError where there is none."""
    if tool in BASELINES:
        return lambda arguments, limit: _inside(tool, arguments)
    try:
        command = TOOLS.get(tool) or shlex.split(tool)
    except ValueError:  # a quotation that does not end
        command = []
    if not command or shutil.which(command[0]) is None:
        known = ", ".join((*TOOLS, *BASELINES))
        raise InputError(f"bench-concealed: no tool {tool!r}; give one of {known}, or a command")
    return lambda arguments, limit: _call([*command, *arguments], limit, tool == OURS)


def run(
    bench: Path,
    tool: str,
    out: Path,
    limit: float,
    cases: int | None = None,
    jobs: int = 1,
    progress: Progress = silent,
) -> dict[str, dict]:
    """Let `tool` answer the (first) `cases` of a split; what was answered before in `out` is kept.

    limit: seconds for an explanation. jobs: cases at a time. Returns case -> content of run.json: seconds, code, error.
    Raises InputError for a folder that is no split, a tool that is not there, or an `out` that cannot be made.
    """
    folders, call = committed(bench, sealed=False), tool_of(tool)
    done: dict[str, dict] = {}
    over = Event()
    chosen = dict(list(folders.items())[:cases])

    def one(name: str) -> None:
        place = Path(out).resolve() / name
        known = json.loads(contents(place / RUN)) if (place / RUN).exists() else None
        found = _case(call, chosen[name], place, Path(bench) / "sealed" / name / "third.csv", limit, known)
        if over.is_set():  # interrupted: the case was not lost by the tool
            return
        (place / RUN).write_text(json.dumps(found) + "\n")
        done[name] = found
        progress(f"{len(done)} of {len(chosen)} cases")

    for name in chosen:
        try:
            (Path(out) / name).mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"{out}: {error.strerror}; give a folder to write to") from None
    pool = ThreadPoolExecutor(jobs)
    futures = [pool.submit(one, name) for name in chosen]
    try:
        for future in as_completed(futures):
            future.result()
    finally:
        over.set()
        pool.shutdown(wait=False, cancel_futures=True)
        while wait(futures, LOOKS).not_done:  # where the run was interrupted: what a tool has started ends with it
            children.stop()
    return {name: done[name] for name in chosen}


def _case(call: Call, folder: Path, place: Path, unseen: Path, limit: float, found: dict | None) -> dict:
    """Explain, and then predict what was kept back: later, if the split's maker has not published it yet.

    found: what an earlier run said of the case.
    """
    with tempfile.TemporaryDirectory() as scratch:  # a tool finds the case alone, under a name that says nothing
        seen, recording = Path(scratch) / "case", Path(scratch) / "unseen.csv"

        def asked(arguments: list[str]) -> dict:
            said = call(arguments, limit)
            return said | {"error": said["error"].replace(f"{scratch}/", "")}

        shutil.copytree(folder, seen)
        if found is None:
            found = asked(["explain", str(seen), str(place)])
            if not found["error"] and not (place / FILE).exists():
                found["error"] = f"wrote no {FILE}"
        if found["error"] or (place / PREDICTED).exists() or not unseen.exists():
            return found
        shutil.copyfile(unseen, recording)
        after = asked(["predict", str(seen), str(place), str(recording)])
        missing = "" if (place / PREDICTED).exists() else f"wrote no {PREDICTED}"
        return found | {"error": after["error"] or missing}


def _inside(baseline: str, arguments: list[str]) -> dict:
    """Run a baseline in this process, without a limit: a start of Python would take longer than it does."""
    began = time.perf_counter()
    what, *paths = arguments
    {"explain": baselines.explain, "predict": baselines.predict}[what](baseline, *map(Path, paths))
    return {"seconds": round(time.perf_counter() - began, 2), "code": 0, "error": ""}


def _call(command: Sequence[str], limit: float, safe: bool) -> dict:
    """Run a tool; whatever it started ends with it. safe: as in `children.started`."""
    began = time.perf_counter()
    silent = {"stdout": children.DEVNULL, "stderr": children.PIPE}
    with children.started(command, safe=safe, **silent) as process:
        try:
            said = process.communicate(timeout=min(limit, LONGEST))[1].strip()
        except children.TimeoutExpired:
            return {"seconds": limit, "code": None, "error": f"not done after {limit:g} s"}
    seconds = round(time.perf_counter() - began, 2)
    last = said.splitlines()[-1][:SAID] if said else f"exit code {process.returncode}"
    return {"seconds": seconds, "code": process.returncode, "error": last if process.returncode else ""}
