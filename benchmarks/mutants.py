"""Mutants: does `make test` notice when a line of the product is changed? Draws changes by a seed, and runs the tests.

python benchmarks/mutants.py --jobs 2 --count 60 --seed 1 --out FILE.jsonl [--limit SECONDS] [--wheels FOLDER]

Every mutant is one small change of one file: a comparison, an operator, a constant, a condition, a dropped statement
or argument, min for max, an end of a range, a line of a template from which code is made. Beside those drawn stand
some by name that had survived once. A mutant runs in a copy of the tree, against the test files that import what it
changes, then against all others; the first failure, or three times the usual time, kills it. Results are appended to
FILE.jsonl part by part, so a run that was stopped goes on where it was, as long as product and tests stay as they are.

Before, the unchanged tree passes the same commands: what fails there (a tool is missing, say) is left out and counted.
"""

import argparse
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
from collections.abc import Iterator
from concurrent.futures import FIRST_COMPLETED, ThreadPoolExecutor, wait
from functools import cache
from pathlib import Path
from threading import Event

from made import stamp
from mutations import ROOT, Mutant, drawn, named

SKIPPED = {".git", ".venv", ".hypothesis", ".pytest_cache", ".ruff_cache", "build", "demo", "hardware", "__pycache__"}
PRODUCT = ("greygate", "models", "compiler", "emulator", "rtl", "plants", "mismatch", "machines")
PART = 60.0  # s of test files that run in one process
SLOW = 3.0  # times the usual duration kill a mutant
SLACK = 60.0  # s beside that, in which numba compiles anew
WANTED = 0.9  # share of mutants that must be killed


FINDER = '''"""Finds greygate's packages in the tree that GREYGATE_TREE names, as an editable install would."""
import importlib.util, os, sys
PACKAGES = {packages!r}
TREE = os.environ.get("GREYGATE_TREE")
class Finder:
    @staticmethod
    def find_spec(name, path=None, target=None):
        if TREE and name in PACKAGES:
            folder = os.path.join(TREE, PACKAGES[name])
            return importlib.util.spec_from_file_location(
                name, os.path.join(folder, "__init__.py"), submodule_search_locations=[folder])
sys.meta_path.insert(0, Finder)
'''

PLUGIN = '''"""Tells what failed, leaves out what fails anyway, and looks for no smallest failing example."""
import json, os
import pytest
from hypothesis import Phase, settings
settings.register_profile("mutants", phases=[Phase.explicit, Phase.reuse, Phase.generate])
settings.load_profile("mutants")
LEFT_OUT = set(json.loads(os.environ["GREYGATE_LEFT_OUT"]))
FAILED = []
def pytest_collection_modifyitems(config, items):
    items[:] = [item for item in items if item.nodeid not in LEFT_OUT]
def pytest_runtest_logreport(report):
    if report.failed:
        FAILED.append(report.nodeid)
def pytest_collectreport(report):
    if report.failed:
        FAILED.append(report.nodeid)
def pytest_sessionfinish(session):
    with open(os.environ["GREYGATE_FAILED"], "w") as out:
        json.dump(FAILED, out)
'''


class Stopped(Exception):
    """The time limit of the run."""


class Bench:
    """A folder with an environment for the tests, and an unchanged tree whose caches are warm."""

    def __init__(self, work: Path, wheels: Path | None, until: float):
        self.work, self.until, self.stop = work, until, Event()
        self.prime, self.python = work / "prime", work / "venv" / "bin" / "python"
        self.left_out: list[str] = []
        if not self.python.exists():
            self._environment(wheels)
        if not self.prime.exists():
            shutil.copytree(ROOT, self.prime, ignore=lambda _, names: SKIPPED & set(names))

    def _environment(self, wheels: Path | None) -> None:
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
        if wheels:
            files = sorted(map(str, wheels.glob("*.whl")))
            pip = [sys.executable, "-m", "pip", "install", "--quiet", "--no-index", "--no-deps", "--no-compile"]
            subprocess.run([*pip, "--target", str(site), *files], check=True)

    def pytest(self, tree: Path, files: list[str], timeout: float, first: bool) -> tuple[int | None, list[str]]:
        """(exit code of pytest in a tree, None out of time; what failed). Raises Stopped at the run's own end."""
        report = Path(tempfile.mkstemp(dir=self.work, suffix=".json")[1])
        environment = os.environ | {
            "GREYGATE_TREE": str(tree),
            "GREYGATE_LEFT_OUT": json.dumps(self.left_out),
            "GREYGATE_FAILED": str(report),
            "XDG_CACHE_HOME": str(tree / ".cache"),
            "OMP_NUM_THREADS": "1",
            "PATH": f"{self.python.parent}{os.pathsep}{os.environ['PATH']}",
        }
        command = [str(self.python), "-m", "pytest", "-q", "-p", "no:cacheprovider", "-p", "greygate_mutants"]
        command += ["-p", "no:xdist", *(["-x"] if first else []), *files]
        silent = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        process = subprocess.Popen(command, cwd=tree, env=environment, start_new_session=True, **silent)
        ends = time.monotonic() + timeout
        try:
            while process.poll() is None:
                if self.stop.is_set() or time.monotonic() > self.until:
                    raise Stopped
                if time.monotonic() > ends:
                    return None, []
                time.sleep(0.2)
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
            told = report.read_text()
            report.unlink()
        return process.returncode, json.loads(told or "[]")

    def baseline(self, files: list[str], jobs: int) -> dict[str, float]:
        """Seconds of every test file that the unchanged tree passes; other tests are noted as left out."""
        kept = self.work / "baseline.json"
        known = json.loads(kept.read_text()) if kept.exists() else {"seconds": {}, "left_out": []}
        self.left_out = known["left_out"]

        def one(file: str) -> None:
            began = time.monotonic()
            code, failed = self.pytest(self.prime, [file], 1800, first=False)
            if code not in (0, 1, 5):  # not even collected
                failed = [file]
            known["seconds"][file] = time.monotonic() - began
            known["left_out"] += failed

        todo = [f for f in files if f not in known["seconds"]]
        todo.sort(key=lambda f: -(self.prime / f).stat().st_size)
        try:
            with ThreadPoolExecutor(jobs) as pool:
                list(pool.map(one, todo))
        finally:
            kept.write_text(json.dumps(known))
        return {f: known["seconds"][f] for f in files if f not in known["left_out"]}

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
            code, failed = self.pytest(tree, part, SLOW * usual + SLACK, first=True)
        finally:
            shutil.rmtree(tree, ignore_errors=True)
        outcome = "timeout" if code is None else "passed" if code in (0, 5) else "killed"
        by = failed[:1] or [f"exit code {code}"] * (outcome == "killed")
        return {"outcome": outcome, "by": by, "seconds": round(time.monotonic() - began, 1)}


@cache
def importing(path: Path, module: str) -> bool:
    package, _, name = module.rpartition(".")
    return bool(re.search(rf"{re.escape(module)}\b|from {re.escape(package)} import .*\b{name}\b", path.read_text()))


def dotted(path: Path) -> str:
    """The module of a source file."""
    name = path.relative_to(ROOT).with_suffix("").as_posix().replace("/", ".")
    return name if name.startswith("greygate.") else f"greygate.{name}"


@cache
def nearness(file: str) -> dict[str, int]:
    """Of every test file to a source file: 0 imports it, 1 imports what imports it, 2 neither."""
    changed = dotted(ROOT / file)
    above = [dotted(p) for f in PRODUCT for p in (ROOT / f).rglob("*.py") if importing(p, changed)]
    near = {}
    for path in (ROOT / "tests").glob("test_*.py"):
        near[path.relative_to(ROOT).as_posix()] = (
            0 if importing(path, changed) else 1 if any(importing(path, m) for m in above) else 2
        )
    return near


def parts(mutant: Mutant, seconds: dict[str, float]) -> list[list[str]]:
    """Test files in portions, the nearest and quickest first."""
    near = nearness(mutant.file)
    found: list[list[str]] = [[]]
    for file in sorted(seconds, key=lambda f: (near[f], seconds[f])):
        if found[-1] and sum(seconds[f] for f in found[-1]) + seconds[file] > PART:
            found.append([])
        found[-1].append(file)
    return found


def digest() -> str:
    """Of product and tests: results of others do not count."""
    told = hashlib.sha256()
    paths = [p for f in PRODUCT for p in (ROOT / f).rglob("*.py")] + list((ROOT / "tests").glob("*.py"))
    for path in sorted(paths):
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


def run(bench: Bench, mutants: list[Mutant], seconds: dict[str, float], results: Results, jobs: int) -> None:
    """All mutants against their nearest tests, then those that live on against the next, and so on."""

    def waiting() -> Iterator[tuple[Mutant, list[str]]]:
        queues = {m: parts(m, seconds) for m in mutants}
        for k in range(max(map(len, queues.values()), default=0)):
            for m in mutants:
                part = [f for f in queues[m][k] if f not in results.passed(m)] if k < len(queues[m]) else []
                if part and not results.killed(m):
                    yield m, part

    def one(mutant: Mutant, part: list[str]) -> tuple[Mutant, list[str], dict]:
        return mutant, part, bench.trial(mutant, part, sum(seconds[f] for f in part))

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
                    print(f"{told['outcome']:8} {told['seconds']:6.1f} s  {mutant.name}  {' '.join(told['by'])}")
        except (Stopped, KeyboardInterrupt):
            print("stopped; the same command goes on from here")
        finally:
            bench.stop.set()


def summary(mutants: list[Mutant], results: Results, seconds: dict[str, float]) -> list[dict]:
    """What is known of every mutant: killed and by what, survived, or unfinished."""
    told = []
    for m in mutants:
        killer = results.killed(m)
        whole = set(seconds) <= results.passed(m)
        outcome = killer["outcome"] if killer else "survived" if whole else "unfinished"
        told.append({"mutant": m.name, "outcome": outcome} | ({"by": killer["by"]} if killer else {}))
    return told


def report(content: list[dict], path: Path | None, head: dict) -> bool:
    """Print what came out, and write it, the reasons that a person gave in the file before kept. True if it will do."""

    def known(name: str) -> str:
        return re.sub(r":\d+ ", " ", name, count=1)  # lines move

    reasons = {}
    if path and path.exists():
        reasons = {known(e["mutant"]): e["reason"] for e in json.loads(path.read_text())["mutants"] if "reason" in e}
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
    if path:
        counts = {"drawn": len(entries), "killed": dead} | {o: len(by[o]) for o in ("survived", "unfinished")}
        path.write_text(json.dumps(head | counts | {"mutants": entries}, indent=1) + "\n")
        stamp(path)
    return not by["unfinished"] and dead >= WANTED * len(entries)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--count", type=int, default=60, help="mutants drawn, beside those by name")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--out", type=Path, default=Path("mutants.jsonl"), help="results, appended part by part")
    parser.add_argument("--report", type=Path, help="a JSON file of what came out; reasons given in it are kept")
    parser.add_argument("--limit", type=float, default=1e9, help="s after which the run stops cleanly")
    parser.add_argument("--wheels", type=Path, help="folder of wheels that this machine lacks")
    parser.add_argument("--work", type=Path, help="folder for copies, kept; the same one again saves the baseline")
    parser.add_argument("--only", help="mutants whose name holds this alone")
    parser.add_argument("--tests", nargs="*", help="these test files alone; what survives them has not survived all")
    parser.add_argument("--list", action="store_true", help="print the mutants, run nothing")
    given = parser.parse_args()
    until = time.monotonic() + given.limit
    mutants = [m for m in [*named(), *drawn(given.count, given.seed)] if (given.only or "") in m.name]
    print(f"{len(mutants)} mutants, seed {given.seed}")
    if given.list:
        print("\n".join(f"{m.key} {m.name}" for m in mutants))
        return 0
    files = given.tests or [p.relative_to(ROOT).as_posix() for p in sorted((ROOT / "tests").glob("test_*.py"))]
    tree = digest()
    work = (given.work or Path(tempfile.gettempdir())) / f"greygate-mutants-{tree}"
    work.mkdir(parents=True, exist_ok=True)
    bench = Bench(work.resolve(), given.wheels, until)
    try:
        seconds = bench.baseline(files, given.jobs)
    except Stopped:
        print("stopped before the unchanged tree was through; give it more time")
        return 1
    slowest = ", ".join(f"{f} {seconds[f]:.0f} s" for f in sorted(seconds, key=seconds.get)[-3:])
    print(
        f"unchanged: {len(seconds)} of {len(files)} test files, {sum(seconds.values()):.0f} s; "
        f"{len(bench.left_out)} tests left out, which fail here anyway; slowest {slowest}"
    )
    results = Results(given.out, tree)
    run(bench, mutants, seconds, results, given.jobs)
    head = {"seed": given.seed, "left_out": sorted(bench.left_out)}
    return 0 if report(summary(mutants, results, seconds), given.report, head) else 1


if __name__ == "__main__":
    sys.exit(main())
