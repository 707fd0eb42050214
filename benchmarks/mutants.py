"""Mutants: does `make test` notice when a line of the product is changed? Draws changes by a seed, and runs the tests.

Every mutant is one small change of one file: a comparison, an operator, a constant, a condition, a dropped statement
or argument, min for max, an end of a range, a line of a template from which code is made. Beside those drawn stand
some by name that had survived once. Before, the unchanged tree passes every test file, and it is noted which test calls
which function, and for how long it runs; what fails there (a tool is missing, say) is left out and counted. A mutant
runs in a copy of the tree against the tests that call its function, the nearest and quickest files first; the first
failure, or three times the usual time, kills it. Results are appended to --out part by part, so a run that was
stopped goes on where it was, as long as product and tests stay as they are. A run of all tests is kept in
results/mutants.json, with the reasons that a person gave there for survivors.
"""

import ast
import hashlib
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
import venv
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from functools import cache
from pathlib import Path
from threading import Event
from typing import Annotated

from .made import ROOT, store, stored
from .mutations import TEMPLATES, Mutant, drawn, named, sources
from .shared import Jobs

TAKES = "hours"
THREADS = "all"
NEEDS = ("pytest", "hypothesis")

SKIPPED = (".git", ".venv", ".*_cache", ".hypothesis", "__pycache__", "*.egg-info")
PART = 60.0  # s of tests that run in one process
SLOW = 3.0  # times the usual duration kill a mutant
SLACK = 60.0  # s beside that, in which numba compiles anew
WANTED = 0.92  # share of mutants that must be killed


FINDER = '''"""Finds greygate's packages in the tree that GREYGATE_TREE names, if it is set; notes calls."""
import importlib.util, os, sys, threading
PACKAGES = {packages!r}
TREE, CALLED = os.environ.get("GREYGATE_TREE"), os.environ.get("GREYGATE_CALLED")
NOTED = set()
WHERE = os.environ.get("PYTEST_CURRENT_TEST", "import").rpartition(" ")[0]
if any("loky" in word for word in sys.orig_argv):  # a worker serves other tests of the file too
    WHERE = WHERE.partition("::")[0]
class Finder:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if TREE and name in PACKAGES:
            folder = os.path.join(TREE, PACKAGES[name])
            return importlib.util.spec_from_file_location(
                name, os.path.join(folder, "__init__.py"), submodule_search_locations=[folder])
sys.meta_path.insert(0, Finder)
def within(where):
    global WHERE
    WHERE, before = where, WHERE
    NOTED.clear()
    return before
def note(frame, event, argument):
    code = frame.f_code
    if code.co_filename.startswith(TREE):
        at = code.co_filename, code.co_firstlineno
        if at not in NOTED:
            NOTED.add(at)
            try:
                os.write(OUT, f"{{WHERE}}\\t{{code.co_filename[len(TREE) + 1:]}}:{{code.co_firstlineno}}\\n".encode())
            except OSError:  # a test of full disks
                pass
if CALLED:
    OUT = os.open(CALLED, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    threading.settrace(note)
    sys.settrace(note)
'''

PLUGIN = '''"""Runs the tests wanted, shrinks no example; tells what failed, seconds, and fixtures used."""
import functools, json, os, sys, time
import greygate_mutated
import pytest
from hypothesis import Phase, settings
with open(os.environ["GREYGATE_ASKED"]) as file:
    ASKED = json.load(file)
TOLD = {"failed": [], "seconds": {}, "fixtures": {}}
def pytest_configure(config):  # after the profile of the tests
    settings.register_profile("mutants", settings(), phases=[Phase.explicit, Phase.reuse, Phase.generate])
    settings.load_profile("mutants")
def pytest_collection_modifyitems(config, items):
    if ASKED["wanted"] is not None:
        place = {name: k for k, name in enumerate(ASKED["wanted"])}
        items[:] = sorted((i for i in items if i.nodeid in place), key=lambda i: place[i.nodeid])
    TOLD["fixtures"] = {i.nodeid: list(i.fixturenames) for i in items}
def forget():
    for module in list(sys.modules.values()):
        if str(getattr(module, "__file__", "")).startswith(greygate_mutated.TREE):
            for found in list(vars(module).values()):
                if isinstance(found, functools._lru_cache_wrapper):
                    found.cache_clear()
@pytest.hookimpl(hookwrapper=True)
def pytest_runtest_protocol(item):
    if greygate_mutated.CALLED:
        forget()
        greygate_mutated.within(item.nodeid)
    began = time.monotonic()
    yield
    TOLD["seconds"][item.nodeid] = time.monotonic() - began
@pytest.hookimpl(hookwrapper=True)
def pytest_fixture_setup(fixturedef, request):
    shared = fixturedef.scope != "function"
    before = shared and greygate_mutated.within("fixture " + fixturedef.argname)
    yield
    if shared:
        greygate_mutated.within(before)
def pytest_runtest_logreport(report):
    if report.failed:
        TOLD["failed"].append(report.nodeid)
def pytest_collectreport(report):
    if report.failed:
        TOLD["failed"].append(report.nodeid)
def pytest_sessionfinish(session):
    with open(ASKED["told"], "w") as out:
        json.dump(TOLD, out)
'''


class Stopped(Exception):
    """The time limit of the run."""


class Bench:
    """A folder with an environment for the tests, and an unchanged tree whose caches are warm."""

    def __init__(self, work: Path, until: float):
        self.work, self.until, self.stop = work, until, Event()
        self.prime, self.python = work / "prime", work / "venv" / "bin" / "python"
        self.left_out: list[str] = []
        self._environment()
        if not self.prime.exists():
            shutil.copytree(ROOT, self.prime, ignore=shutil.ignore_patterns(*SKIPPED))

    def _environment(self) -> None:
        if not self.python.exists():
            venv.create(self.work / "venv", system_site_packages=True, symlinks=True)
        (site,) = (self.work / "venv").glob("lib/python*/site-packages")
        setuptools = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]
        (site / "greygate_mutated.py").write_text(FINDER.format(packages=setuptools["package-dir"]))
        (site / "greygate_mutants.py").write_text(PLUGIN)
        borrowed = [p for p in sys.path[1:] if p.endswith(("site-packages", "dist-packages"))]
        (site / "greygate.pth").write_text("\n".join([*borrowed, "import greygate_mutated"]) + "\n")
        command = self.work / "venv" / "bin" / "greygate"
        command.write_text(f"#!{self.python}\nfrom greygate.cli import run\nrun()\n")
        command.chmod(0o755)

    def pytest(
        self,
        tree: Path,
        files: list[str],
        limit: float,
        *,
        wanted: list[str] | None = None,
        called: str = "",
        first: bool = False,
    ) -> tuple[int | None, dict]:
        """(exit code of pytest in a tree, None out of time; what the plugin tells). Raises Stopped at the run's end.

        wanted: these tests alone. called: a file to which what each calls is added. first: stop at the first failure.
        """
        told, asked = self.work / f"told-{tree.name}.json", self.work / f"asked-{tree.name}.json"
        told.unlink(missing_ok=True)
        asked.write_text(json.dumps({"wanted": wanted, "told": str(told)}))
        environment = os.environ | {
            "GREYGATE_TREE": str(tree),
            "GREYGATE_ASKED": str(asked),
            "GREYGATE_CALLED": called,
            "XDG_CACHE_HOME": str(tree / ".cache"),
            "OMP_NUM_THREADS": "1",
            "PATH": f"{self.python.parent}{os.pathsep}{os.environ['PATH']}",
        }
        command = [str(self.python), "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "greygate_mutants"]
        command += ["-W", "ignore:mypy_extensions"]  # which hypothesis imports where an example fails
        command += ["-p", "no:xdist", *(["-x"] if first else []), *files]
        silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        process = subprocess.Popen(command, cwd=tree, env=environment, start_new_session=True, **silent)
        ends = time.monotonic() + limit
        try:
            while process.poll() is None:
                if self.stop.is_set() or time.monotonic() > self.until:
                    raise Stopped
                if time.monotonic() > ends:
                    return None, {"failed": []}
                time.sleep(0.1)
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        return process.returncode, json.loads(told.read_text()) if told.exists() else {"failed": []}

    def baseline(self, files: list[str], jobs: int) -> dict[str, float]:
        """Seconds of every test that the unchanged tree passes, and a file of what it calls; others are left out."""
        kept = self.work / "baseline.json"
        known = json.loads(kept.read_text()) if kept.exists() else {}

        def one(file: str) -> None:
            called = self.called(file)
            called.unlink(missing_ok=True)
            code, told = self.pytest(self.prime, [file], 1800, called=str(called))
            if told["failed"]:  # a tool is missing; or it was too slow while calls were noted
                told["failed"] = self.pytest(self.prime, [file], 1800, wanted=told["failed"])[1]["failed"]
            known[file] = told if code in (0, 1, 5) else {"failed": [file], "seconds": {}, "fixtures": {}}
            kept.write_text(json.dumps(known))
            print(f"unchanged: {file} {sum(known[file]['seconds'].values()):.0f} s", *told["failed"], flush=True)

        todo = [f for f in files if f not in known]
        with ThreadPoolExecutor(jobs) as pool:
            list(pool.map(one, todo))
        told = [known[f] for f in files]
        self.left_out = [name for t in told for name in t["failed"]]
        self.fixtures = {name: used for t in told for name, used in t["fixtures"].items()}
        return {n: s for t in told for n, s in t["seconds"].items() if n not in self.left_out}

    def called(self, file: str) -> Path:
        return self.work / f"{Path(file).stem}.called"

    def trial(self, mutant: Mutant, part: list[str], usual: float) -> dict:
        """What a part of the tests says of a mutant. The tree is made of links, so that it costs nothing."""
        tree = Path(tempfile.mkdtemp(dir=self.work, prefix="tree-"))
        try:
            shutil.copytree(self.prime, tree, copy_function=os.link, dirs_exist_ok=True)
            path = tree / mutant.file
            changed = mutant.text(path.read_bytes())
            path.unlink()
            path.write_bytes(changed)
            if b"njit" in changed:  # compiled callers in other files hold the unchanged kernel
                for cached in tree.rglob("*.nbi"):
                    cached.unlink()
            began = time.monotonic()
            files = list(dict.fromkeys(name.partition("::")[0] for name in part))
            code, told = self.pytest(tree, files, SLOW * usual + SLACK, wanted=part, first=True)
        finally:
            shutil.rmtree(tree, ignore_errors=True)
        outcome = "timeout" if code is None else "passed" if code in (0, 5) else "killed"
        by = told["failed"][:1] or [f"exit code {code}"] * (outcome == "killed")
        return {"outcome": outcome, "by": by, "seconds": round(time.monotonic() - began, 1)}


class Reach:
    """Which tests reach a place of the source: those that call its function. seconds: of the tests that count.

    What is compiled, made into code, kept for later calls or done at an import is noted nowhere: it is reached by all
    that call something of its file, or of a file that imports it.
    """

    def __init__(self, bench: Bench, seconds: dict[str, float]):
        self.seconds = seconds
        self.tests: dict[str, set[str]] = {}  # FILE:LINE of a function -> tests
        self.imported: set[str] = set()  # what is called while test files are imported
        for file in sorted({name.partition("::")[0] for name in seconds}):
            users: dict[str, list[str]] = {file: []}  # of a test, a shared fixture, a worker of the whole file
            for name in (n for n in seconds if n.startswith(f"{file}::")):
                for user in (file, name, *(f"fixture {f}" for f in bench.fixtures[name])):
                    users.setdefault(user, []).append(name)
            for line in set(bench.called(file).read_text(errors="replace").splitlines()):
                user, _, place = line.rpartition("\t")
                if not place.startswith("tests/"):
                    self.tests.setdefault(place, set()).update(users.get(user, ()))
                    self.imported |= set() if user else {place}
        self.files: dict[str, set[str]] = {}
        for place, tests in self.tests.items():
            self.files.setdefault(place.rpartition(":")[0], set()).update(tests)

    def callers(self, mutant: Mutant) -> set[str]:
        """Tests that call the function in which a mutant stands."""
        source = (ROOT / mutant.file).read_bytes()
        line = 1 + source.count(b"\n", 0, mutant.start)
        functions = (n for n in ast.walk(ast.parse(source)) if isinstance(n, ast.FunctionDef | ast.AsyncFunctionDef))
        home = max((n for n in functions if n.lineno <= line <= n.end_lineno), key=lambda n: n.lineno, default=None)
        first = min([home.lineno, *(d.lineno for d in home.decorator_list)]) if home else 0
        place = f"{mutant.file}:{first}"
        return set() if place in self.imported else self.tests.get(place, set()) & self.seconds.keys()

    def of(self, mutant: Mutant) -> set[str]:
        """Tests that reach a mutant; all of the files that import it, if none is known to."""
        callers = self.callers(mutant)
        if callers and b"jit" not in (ROOT / mutant.file).read_bytes() and mutant.file not in TEMPLATES:
            return callers
        near = {f for f, rank in nearness(mutant.file).items() if rank == 0}
        found = set().union(*(self.files.get(f, ()) for f in above(mutant.file))) & self.seconds.keys()
        return found | {name for name in self.seconds if name.partition("::")[0] in near}

    def parts(self, mutant: Mutant) -> list[list[str]]:
        """These tests in portions: callers, then the nearest and quickest files, of each the quickest tests."""
        callers, near, files = self.callers(mutant), nearness(mutant.file), {}
        for name in sorted(self.of(mutant), key=lambda n: (self.seconds[n], n)):
            files.setdefault((name not in callers, name.partition("::")[0]), []).append(name)
        found = [[]]
        for group in sorted(files, key=lambda g: (g[0], near[g[1]], self.takes(files[g]))):
            for name in files[group]:
                if found[-1] and self.takes([*found[-1], name]) > PART:
                    found.append([])
                found[-1].append(name)
        return found

    def takes(self, names: list[str]) -> float:
        return sum(self.seconds[n] for n in names)


@cache
def importing(path: Path, module: str) -> bool:
    package, _, name = module.rpartition(".")
    return bool(re.search(rf"{re.escape(module)}\b|from {re.escape(package)} import .*\b{name}\b", path.read_text()))


def dotted(path: Path) -> str:
    """The module of a source file."""
    name = path.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".")
    return name if name.startswith("greygate.") else f"greygate.{name}"


@cache
def above(file: str) -> frozenset[str]:
    """A source file and those that import it; what imports a compiled one of them too."""
    found, todo = {file}, [file]
    while todo:
        changed = todo.pop()
        if changed == file or b"jit" in (ROOT / changed).read_bytes():
            more = {p.relative_to(ROOT).as_posix() for p in sources() if importing(p, dotted(ROOT / changed))} - found
            found |= more
            todo += more
    return frozenset(found)


@cache
def nearness(file: str) -> dict[str, int]:
    """Of every test file to a source file: 0 imports it, 1 imports what imports it, 2 neither."""
    changed, others = dotted(ROOT / file), [dotted(ROOT / f) for f in above(file)]
    near = {}
    for path in (ROOT / "tests").glob("test_*.py"):
        near[path.relative_to(ROOT).as_posix()] = (
            0 if importing(path, changed) else 1 if any(importing(path, m) for m in others) else 2
        )
    return near


def digest() -> str:
    """Of product and tests: results of others do not count."""
    told = hashlib.sha256()
    for path in [*sources(), *sorted((ROOT / "tests").glob("*.py"))]:
        told.update(path.relative_to(ROOT).as_posix().encode() + path.read_bytes())
    return told.hexdigest()[:12]


class Results:
    """FILE.jsonl: one line for every part of the tests that a mutant was run against."""

    def __init__(self, path: Path, tree: str):
        self.path, self.tree = path, tree
        self.lines: dict[str, list[dict]] = {}
        for line in path.read_text().splitlines() if path.exists() else ():
            entry = json.loads(line)
            if entry["tree"] == tree:
                self.lines.setdefault(entry["key"], []).append(entry)

    def add(self, mutant: Mutant, part: list[str], told: dict) -> None:
        entry = {"key": mutant.key, "tree": self.tree, "mutant": mutant.name, **told, "tests": part}
        self.lines.setdefault(mutant.key, []).append(entry)
        with self.path.open("a") as out:
            out.write(json.dumps(entry) + "\n")

    def killed(self, mutant: Mutant) -> dict | None:
        return next((e for e in self.lines.get(mutant.key, ()) if e["outcome"] != "passed"), None)

    def passed(self, mutant: Mutant) -> set[str]:
        return {f for e in self.lines.get(mutant.key, ()) if e["outcome"] == "passed" for f in e["tests"]}


def run(bench: Bench, mutants: list[Mutant], reach: Reach, results: Results, jobs: int) -> None:
    """All mutants against their nearest tests, then those that live on against the next, and so on."""

    def waiting() -> Iterator[tuple[Mutant, list[str]]]:
        queues = {m: reach.parts(m) for m in mutants}
        for k in range(max(map(len, queues.values()), default=0)):
            for m in mutants:
                part = [n for n in queues[m][k] if n not in results.passed(m)] if k < len(queues[m]) else []
                if part and not results.killed(m):
                    yield m, part

    def one(mutant: Mutant, part: list[str]) -> tuple[Mutant, list[str], dict]:
        return mutant, part, bench.trial(mutant, part, reach.takes(part))

    running, queue = set(), waiting()
    with ThreadPoolExecutor(jobs) as pool:
        try:
            while True:
                for unit in queue:
                    running.add(pool.submit(one, *unit))
                    if len(running) >= jobs:
                        break
                if not running:
                    break
                done, running = wait(running, return_when=FIRST_COMPLETED)
                for mutant, part, told in (future.result() for future in done):
                    if not results.killed(mutant):
                        results.add(mutant, part, told)
                    print(
                        f"{told['outcome']:8} {told['seconds']:6.1f} s  {mutant.name}  {' '.join(told['by'])}",
                        flush=True,
                    )
        except (Stopped, KeyboardInterrupt):
            print("stopped; the same command goes on from here")
        finally:
            bench.stop.set()


def summary(mutants: list[Mutant], results: Results, reach: Reach) -> list[dict]:
    """What is known of every mutant: killed and by what, survived, or unfinished."""
    told = []
    for m in mutants:
        killer = results.killed(m)
        whole = reach.of(m) <= results.passed(m)
        outcome = killer["outcome"] if killer else "survived" if whole else "unfinished"
        told.append({"mutant": m.name, "outcome": outcome} | ({"by": killer["by"]} if killer else {}))
    return told


def report(content: list[dict], kept: bool, head: dict) -> bool:
    """Print what came out, and write it, the reasons that a person gave in the file before kept. True if it will do."""

    def known(name: str) -> str:
        return re.sub(r":\d+ ", " ", name, count=1)  # lines move

    before = stored("mutants").get("mutants", [])
    reasons = {known(e["mutant"]): e["reason"] for e in before if "reason" in e}
    entries = []
    for e in content:
        why = reasons.get(known(e["mutant"])) if e["outcome"] in ("survived", "unfinished") else None
        entries.append(e | ({"reason": why} if why else {}))
    by = {o: [e for e in entries if e["outcome"] == o] for o in ("killed", "timeout", "survived", "unfinished")}
    dead = len(by["killed"]) + len(by["timeout"])
    for e in by["survived"] + by["unfinished"]:
        print(f"{e['outcome']:10} {e['mutant']}  {e.get('reason', '')}")
    print(
        f"killed {dead} of {len(entries)} ({len(by['timeout'])} out of time), survived {len(by['survived'])}, "
        f"unfinished {len(by['unfinished'])}"
    )
    if kept:
        counts = {"drawn": len(entries), "killed": dead} | {o: len(by[o]) for o in ("survived", "unfinished")}
        store("mutants", head | counts | {"mutants": entries})
    return not by["unfinished"] and dead >= WANTED * len(entries)


def main(
    *,
    jobs: Jobs = 2,
    count: Annotated[int, "mutants drawn, beside those by name"] = 120,
    seed: int = 1,
    out: Annotated[Path, "results, appended part by part"] = Path("build/mutants.jsonl"),
    limit: Annotated[float, "s after which the run stops cleanly"] = 1e9,
    work: Annotated[Path, "folder for copies, kept; the same one again saves the baseline"] = Path("/tmp"),
    only: Annotated[str, "mutants whose name holds this alone; nothing is kept"] = "",
    tests: Annotated[Sequence[str], "these test files alone; what survives them has not survived all"] = (),
    show: Annotated[bool, "print the mutants, run nothing"] = False,
) -> int:
    until = time.monotonic() + limit
    mutants = [m for m in [*named(), *drawn(count, seed)] if only in m.name]
    print(f"{len(mutants)} mutants, seed {seed}")
    if show:
        print("\n".join(f"{m.key} {m.name}" for m in mutants))
        return 0
    files = tests or [p.relative_to(ROOT).as_posix() for p in sorted((ROOT / "tests").glob("test_*.py"))]
    tree = digest()
    work = work / f"greygate-mutants-{tree}"
    out.parent.mkdir(parents=True, exist_ok=True)
    work.mkdir(parents=True, exist_ok=True)
    bench = Bench(work.resolve(), until)
    try:
        seconds = bench.baseline(files, jobs)
    except Stopped:
        print("stopped before the unchanged tree was through; give it more time")
        return 1
    print(f"unchanged: {len(seconds)} tests, {sum(seconds.values()):.0f} s; {len(bench.left_out)} fail here anyway")
    reach = Reach(bench, seconds)
    results = Results(out, tree)
    run(bench, mutants, reach, results, jobs)
    head = {"seed": seed, "left_out": sorted(bench.left_out)}
    return 0 if report(summary(mutants, results, reach), not (only or tests), head) else 1
