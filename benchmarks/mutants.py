"""Mutants: does `make test` notice when a line of the product is changed? Draws changes by a seed, and runs the tests.

python benchmarks/mutants.py --jobs 2 --count 60 --seed 1 --out FILE.jsonl [--limit SECONDS] [--wheels FOLDER]

Every mutant is one small change of one file: a comparison, an operator, a constant, a condition, a dropped statement
or argument, min for max, an end of a range, a line of a template from which code is made. Beside those drawn stand
twelve by name that had survived once. A mutant runs in a copy of the tree, against the test files that import what it
changes, then against all others; the first failure, or three times the usual time, kills it. Results are appended to
FILE.jsonl part by part, so a run that was stopped goes on where it was, as long as product and tests stay as they are.

Before, the unchanged tree passes the same commands: what fails there (a tool is missing, say) is left out and counted.
"""

import argparse
import ast
import hashlib
import json
import os
import random
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
from dataclasses import dataclass
from pathlib import Path
from threading import Event

ROOT = Path(__file__).resolve().parents[1]
AREAS = {
    "compiler": "compiler/*.py",
    "emulator": "emulator/*.py",
    "kernels": "models/kernels.py",
    "fit": "mismatch/fit.py",
    "selection": "mismatch/selection.py",
    "simulate": "plants/simulate.py",
}
TEMPLATES = ("emulator/specialised.py", "plants/simulate.py", "compiler/folded.py", "compiler/parallel.py")
TOLD = {"say", "print", "progress", "notes"}  # what is only told to the user
SKIPPED = {".git", ".venv", ".hypothesis", ".pytest_cache", ".ruff_cache", "build", "demo", "hardware", "__pycache__"}
PART = 60.0  # s of test files that run in one process
SLOW = 3.0  # times the usual duration kill a mutant
SLACK = 60.0  # s beside that, in which numba compiles anew
WANTED = 0.9  # share of mutants that must be killed


@dataclass(frozen=True)
class Mutant:
    """One change: `old` at byte `start` of a file becomes `new`. name: of one of the twelve, else where and what."""

    file: str
    start: int
    old: str
    new: str
    name: str

    @property
    def key(self) -> str:
        return hashlib.sha256(repr((self.file, self.start, self.old, self.new)).encode()).hexdigest()[:12]

    def text(self, source: bytes) -> bytes:
        old = self.old.encode()
        assert source[self.start : self.start + len(old)] == old, self
        return source[: self.start] + self.new.encode() + source[self.start + len(old) :]


NAMED = {  # what it is: (file, old, new); old stands there once
    "formats without their margin": (
        "compiler/quantize.py",
        "r.magnitude * self.formats.margin, max(",
        "r.magnitude, max(",
    ),
    "the mean of what rounded weights cost is not made up for": (
        "compiler/quantize.py",
        "bias += (w - codes * 2.0**-own) @ self.ranges[_origin(signal.name)].mean",
        "bias += 0.0",
    ),
    "memory by 1/(1 - a)": ("compiler/quantize.py", "return 1 / (1 - pole**2)", "return 1 / (1 - pole)"),
    "accumulators without the rounding constant": (
        "emulator/program.py",
        "signed_width(int(m) + h)",
        "signed_width(int(m))",
    ),
    "a hard limit of slope 1": (
        "models/kernels.py",
        "if activation in (HARDLIM, HARDLIMS):\n        return 0.0, o",
        "if activation in (HARDLIM, HARDLIMS):\n        return 1.0, o",
    ),
    "a held-out tail counts what its record skips": (
        "models/problem.py",
        "skip=max(h, r.skip)",
        "skip=h",
    ),
    "intervals as if errors were white": ("mismatch/fit.py", "return _larger(robust, white)", "return white"),
    "an effect is taken though held-out blocks fit worse": (
        "mismatch/selection.py",
        " or fit.held_out() > current.held_out():",
        ":",
    ),
    "a rate goes on at the lower bound": (
        "plants/simulate.py",
        "x[rate[j]] = max(x[rate[j]], 0.0)",
        "x[rate[j]] = x[rate[j]]",
    ),
    "a rate may grow outward at the lower bound": (
        "plants/simulate.py",
        "(x[j] <= low[j] and dx[moved] < 0.0) or ",
        "",
    ),
    "NAME_layer clashes unseen": (
        "compiler/verilog.py",
        'for used in (name, f"{name}_layer"):',
        "for used in (name,):",
    ),
    "a sensor's reading is not inverted": ("mismatch/model.py", "range(3 if channel in", "range(0 if channel in"),
    "exact sums are centred too": (
        "compiler/centre.py",
        "return bool((powers & (powers - 1) == 0).all()) and not operation.bias.any()",
        "return False",
    ),
}


def named() -> list[Mutant]:
    found = []
    for name, (file, old, new) in NAMED.items():
        source = (ROOT / file).read_bytes()
        if source.count(old.encode()) != 1:
            print(f"{name}: its text is no more in {file}; it is left out")
            continue
        found.append(Mutant(file, source.index(old.encode()), old, new, name))
    return found


# -- drawing ----------------------------------------------------------------------------------------------------------

COMPARED = {"<": "<=", "<=": "<", ">": ">=", ">=": ">", "==": "!=", "!=": "==", "in": "not in", "not in": "in"} | {
    "is": "is not",
    "is not": "is",
}
COMPUTED = {"+": "-", "-": "+", "*": "/", "/": "*", "**": "*", "//": "*", "%": "*", "<<": ">>", ">>": "<<"} | {
    "&": "|",
    "|": "&",
}
WRITTEN = [  # in templates: what, by what
    (r" \+ ", " - "),
    (r" - ", " + "),
    (r" \* ", " + "),
    (r" < ", " <= "),
    (r" > ", " >= "),
    (r" >= ", " > "),
    (r" == ", " != "),
    (r" != ", " == "),
    (r" \+= ", " -= "),
    (r"<< ", ">> "),
    (r">> ", "<< "),
    (r"\bmin\(", "max("),
    (r"\bmax\(", "min("),
    (r"\b0\.0\b", "1.0"),
    (r"\b1\b(?!/)", "2"),
    (r"\b5/", "6/"),
]
PYTHON_WRITTEN = [(r" <= ", " < "), (r"\band\b", "or"), (r"\bor\b", "and")]  # in Verilog "<=" assigns


class Draw:
    """Every mutant of one file."""

    def __init__(self, file: str):
        self.file, self.source = file, (ROOT / file).read_bytes()
        lines = self.source.splitlines(keepends=True)
        self.starts = [0]
        for line in lines:
            self.starts.append(self.starts[-1] + len(line))
        self.found: list[Mutant] = []
        self.visit(ast.parse(self.source), set())

    def at(self, node: ast.AST) -> tuple[int, int]:
        return (
            self.starts[node.lineno - 1] + node.col_offset,
            self.starts[node.end_lineno - 1] + node.end_col_offset,
        )

    def add(self, start: int, end: int, new: str, what: str) -> None:
        old = self.source[start:end].decode()
        line = self.source.count(b"\n", 0, start) + 1
        shown = [" ".join(text.split()) for text in (old, new)]
        shown = [text if len(text) <= 60 else text[:57] + "..." for text in shown]
        mutant = Mutant(self.file, start, old, new, f"{self.file}:{line} {what}: {shown[0]} -> {shown[1]}")
        try:
            ast.parse(mutant.text(self.source))
        except SyntaxError:
            return
        self.found.append(mutant)

    def replace(self, node: ast.AST, new: str, what: str) -> None:
        self.add(*self.at(node), new, what)

    def between(self, left: ast.AST, right: ast.AST, table: dict[str, str], what: str) -> None:
        """Exchange the operator that stands between two nodes."""
        start, end = self.at(left)[1], self.at(right)[0]
        text = self.source[start:end].decode()
        match = re.search(r"not\s+in\b|is\s+not\b|\bin\b|\bis\b|\*\*|//|<<|>>|[<>=!]=|[-+*/%<>&|]", text)
        new = match and table.get(" ".join(match.group().split()))
        if new:
            first = start + len(text[: match.start()].encode())
            self.add(first, first + len(match.group().encode()), new, what)

    def visit(self, node: ast.AST, assigned: set[str]) -> None:
        """Collect the mutants of a node and of what is in it; `assigned`: names that have a value here already."""
        match node:
            case ast.Raise() | ast.Import() | ast.ImportFrom() | ast.Assert():
                return
            case ast.FunctionDef(name="__repr__" | "__str__"):
                return
            case ast.FunctionDef():
                self.body(node.body, {a.arg for a in ast.walk(node.args) if isinstance(a, ast.arg)})
                return
            case ast.ClassDef():
                self.body(node.body, set())
                return
            case ast.Yield(value=ast.JoinedStr() | ast.Constant()):
                return  # a message
            case ast.JoinedStr():
                self.template(node)
                return
            case ast.Constant(value=str()):
                self.template(node)
            case ast.Constant(value=bool(value)):
                self.replace(node, str(not value), "constant")
            case ast.Constant(value=int(value) | float(value)):
                for new in {value + 1, value - 1, type(value)(0)} - {value}:
                    self.replace(node, repr(new) if new >= 0 else f"({new!r})", "constant")
            case ast.Compare():
                for left, right in zip([node.left, *node.comparators], node.comparators, strict=False):
                    self.between(left, right, COMPARED, "comparison")
            case ast.BinOp():
                sides = (ast.JoinedStr, ast.List, ast.Tuple)
                texts = any(isinstance(s, sides) or _is_text(s) for s in (node.left, node.right))
                if not texts:
                    self.between(node.left, node.right, COMPUTED, "operator")
            case ast.BoolOp():
                other = {"and": "or", "or": "and"}
                for left, right in zip(node.values, node.values[1:], strict=False):
                    start, end = self.at(left)[1], self.at(right)[0]
                    word = re.search(rb"\b(and|or)\b", self.source[start:end])
                    if word:
                        self.add(start + word.start(), start + word.end(), other[word.group().decode()], "logic")
            case ast.UnaryOp(op=ast.Not() | ast.USub()):
                self.add(self.at(node)[0], self.at(node.operand)[0], "", "sign or negation dropped")
            case ast.If() | ast.IfExp() | ast.While():
                text = self.source[slice(*self.at(node.test))].decode()
                self.replace(node.test, f"(not ({text}))", "condition")
            case ast.Call():
                self.call(node)
            case ast.Return(value=ast.BinOp() | ast.Call() | ast.Name()):
                self.replace(node.value, "None", "answer dropped")
        for field, value in ast.iter_fields(node):
            if field == "annotation":
                continue
            if field in ("body", "orelse", "finalbody") and isinstance(value, list):
                self.body(value, assigned)
            else:
                for child in value if isinstance(value, list) else [value]:
                    if isinstance(child, ast.AST):
                        self.visit(child, assigned)

    def body(self, statements: list[ast.stmt], assigned: set[str]) -> None:
        for k, s in enumerate(statements):
            if k == 0 and isinstance(s, ast.Expr) and _is_text(s.value):
                continue  # docstring
            if isinstance(s, ast.Expr) and isinstance(s.value, ast.Call):
                if _called(s.value) in TOLD:
                    continue
                self.replace(s, "pass", "statement dropped")
            elif isinstance(s, ast.AugAssign | ast.Continue | ast.Break):
                self.replace(s, "pass", "statement dropped")
            elif isinstance(s, ast.Assign):
                if any(isinstance(t, ast.Subscript) and "notes" in ast.unparse(t) for t in s.targets):
                    continue
                names = {n.id for t in s.targets for n in ast.walk(t) if isinstance(n, ast.Name)}
                if names and (names <= assigned or not all(isinstance(t, ast.Name | ast.Tuple) for t in s.targets)):
                    self.replace(s, "pass", "statement dropped")
                assigned |= names
            self.visit(s, assigned)

    def call(self, node: ast.Call) -> None:
        name = _called(node)
        other = {"min": "max", "max": "min", "minimum": "maximum", "maximum": "minimum"}
        other |= {"floor": "ceil", "ceil": "floor", "any": "all", "all": "any"}
        if name in other:
            end = self.at(node.func)[1]
            self.add(end - len(name), end, other[name], "function")
        if name == "range":
            text = self.source[slice(*self.at(node.args[-1]))].decode()
            self.replace(node.args[-1], f"({text}) - 1", "range")
            if len(node.args) > 1:
                text = self.source[slice(*self.at(node.args[0]))].decode()
                self.replace(node.args[0], f"({text}) + 1", "range")
        for k in node.keywords:
            if k.arg not in (None, "strict", "default"):
                start, end = self.at(k)
                rest = re.match(rb"\s*,\s*", self.source[end:])
                self.add(start, end + (rest.end() if rest else 0), "", "argument dropped")

    def template(self, node: ast.Constant | ast.JoinedStr) -> None:
        """Changes of code that stands in a string."""
        if self.file not in TEMPLATES:
            return
        begin, end = self.at(node)
        text = self.source[begin:end].decode()
        for old, new in WRITTEN + ([] if self.file.startswith("compiler") else PYTHON_WRITTEN):
            for match in re.finditer(old, text):
                line = text[text.rfind("\n", 0, match.start()) + 1 : match.start()]
                if not re.search(r'"""|//|#|import', line):
                    start = begin + len(text[: match.start()].encode())
                    self.add(start, start + len(match.group().encode()), new, "template")


def _is_text(node: ast.AST) -> bool:
    return isinstance(node, ast.Constant) and isinstance(node.value, str)


def _called(node: ast.Call) -> str:
    return getattr(node.func, "attr", getattr(node.func, "id", ""))


def drawn(count: int, seed: int) -> list[Mutant]:
    """`count` mutants, as many from every area, no two on one line."""
    rng = random.Random(seed)
    areas = []
    for pattern in AREAS.values():
        lines: dict[str, list[Mutant]] = {}
        for path in sorted(ROOT.glob(pattern)):
            for m in Draw(path.relative_to(ROOT).as_posix()).found:
                lines.setdefault(m.name.partition(" ")[0], []).append(m)
        shuffled = sorted(lines)
        rng.shuffle(shuffled)
        areas.append([rng.choice(sorted(lines[line], key=lambda m: m.key)) for line in shuffled])
    ranks = max(map(len, areas), default=0)
    return [area[k] for k in range(ranks) for area in areas if k < len(area)][:count]


# -- running ----------------------------------------------------------------------------------------------------------

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
        venv.create(self.work / "venv", system_site_packages=True)
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
        return {"outcome": outcome, "by": failed[:1], "seconds": round(time.monotonic() - began, 1)}


def parts(mutant: Mutant, seconds: dict[str, float], prime: Path) -> list[list[str]]:
    """Test files in portions: those that import what is changed, then those that import its package, then all."""
    package, module = Path(mutant.file).parts[0], Path(mutant.file).stem

    def far(file: str) -> int:
        text = (prime / file).read_text()
        if re.search(rf"greygate\.{package}\.{module}\b|greygate\.{package} import .*\b{module}\b", text):
            return 0
        return 1 if f"greygate.{package}" in text else 2

    found: list[list[str]] = [[]]
    for file in sorted(seconds, key=lambda f: (far(f), seconds[f])):
        if found[-1] and sum(seconds[f] for f in found[-1]) + seconds[file] > PART:
            found.append([])
        found[-1].append(file)
    return found


def digest(files: list[str]) -> str:
    """Of product and tests: results of others do not count."""
    told = hashlib.sha256()
    folders = ("greygate", "models", "compiler", "emulator", "rtl", "plants", "mismatch")
    paths = [p for f in folders for p in (ROOT / f).rglob("*.py")] + list((ROOT / "tests").glob("*.py"))
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
        queues = {m: parts(m, seconds, bench.prime) for m in mutants}
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


def summary(mutants: list[Mutant], results: Results, seconds: dict[str, float]) -> dict:
    """What is known of every mutant: killed and by what, survived, or unfinished."""
    told = []
    for m in mutants:
        killer = results.killed(m)
        whole = set(seconds) <= results.passed(m)
        outcome = killer["outcome"] if killer else "survived" if whole else "unfinished"
        told.append({"mutant": m.name, "outcome": outcome} | ({"by": killer["by"]} if killer else {}))
    return {"mutants": told}


def report(content: dict, path: Path | None, head: dict) -> bool:
    """Print what came out, and write it, the reasons that a person gave in the file before kept. True if it will do."""
    reasons = {}
    if path and path.exists():
        reasons = {e["mutant"]: e["reason"] for e in json.loads(path.read_text())["mutants"] if "reason" in e}
    entries = [e | ({"reason": reasons[e["mutant"]]} if e["mutant"] in reasons else {}) for e in content["mutants"]]
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
    tree = digest(files)
    work = given.work or Path(tempfile.gettempdir()) / f"greygate-mutants-{tree}"
    work.mkdir(parents=True, exist_ok=True)
    bench = Bench(work.resolve(), given.wheels, until)
    try:
        seconds = bench.baseline(files, given.jobs)
    except Stopped:
        print("stopped before the unchanged tree was through; give it more time")
        return 1
    print(
        f"unchanged: {len(seconds)} of {len(files)} test files, {sum(seconds.values()):.0f} s; "
        f"{len(bench.left_out)} tests left out, which fail here anyway"
    )
    results = Results(given.out, tree)
    run(bench, mutants, seconds, results, given.jobs)
    head = {"seed": given.seed, "left_out": sorted(bench.left_out)}
    return 0 if report(summary(mutants, results, seconds), given.report, head) else 1


if __name__ == "__main__":
    sys.exit(main())
