"""Mutants: small changes of the product's source, by name or drawn by a seed. `mutants.py` runs the tests on them."""

import ast
import hashlib
import random
import re
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

from .made import ROOT

PRODUCT = ("greygate", "models", "compiler", "emulator", "rtl", "plants", "mismatch", "machines", "control")
AREAS = (*PRODUCT, "models/training")  # a file is of the longest
TEMPLATES = (
    "plants/simulator.py",
    "compiler/targets/folded.py",
    "compiler/targets/parallel.py",
)
TOLD = {"say", "print", "progress", "notes"}  # what is only told to the user


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
        "bias += product(rounded, self.ranges[_origin(signal.name)].mean)",
        "bias += 0.0",
    ),
    "memory by 1/(1 - a)": ("compiler/quantize.py", "return 1 / (1 - pole**2)", "return 1 / (1 - pole)"),
    "accumulators without the rounding constant": (
        "emulator/program.py",
        "signed_width(int(m) + h)",
        "signed_width(int(m))",
    ),
    "a hard limit of slope 1": (
        "models/activations.py",
        "-xp.ones_like(n)),\n        slope=lambda xp, y: 0.0",
        "-xp.ones_like(n)),\n        slope=lambda xp, y: 1.0",
    ),
    "a held-out tail counts what its record skips": (
        "models/training/record.py",
        "skip=max(h, r.skip)",
        "skip=h",
    ),
    "intervals as if errors were white": ("mismatch/fit.py", "return _larger(robust, white)", "return white"),
    "an effect is taken though held-out blocks fit worse": (
        "mismatch/selection.py",
        " or fit.held_out() > current.held_out())",
        ")",
    ),
    "a rate goes on at the lower bound": (
        "plants/simulator.py",
        "x[rate[j]] = max(x[rate[j]], 0.0)",
        "x[rate[j]] = x[rate[j]]",
    ),
    "a rate may grow outward at the lower bound": (
        "plants/simulator.py",
        "(x[j] <= low[j] and dx[moved] < 0.0) or ",
        "",
    ),
    "NAME_layer clashes unseen": (
        "compiler/verilog.py",
        'for used in (name, f"{name}_layer"):',
        "for used in (name,):",
    ),
    "a sensor's reading is not inverted": ("mismatch/model.py", "range(READINGS if channel", "range(0 if channel"),
    "exact sums are centred too": (
        "compiler/centre.py",
        "return bool((powers & (powers - 1) == 0).all()) and not operation.bias.any()",
        "return False",
    ),
    "a coupling counts from one side alone": (
        "plants/simulator.py",
        "e.state in rates or equation.state in e.couples",
        "e.state in rates",
    ),
    "a coupling counts from the other side alone": (
        "plants/simulator.py",
        "e.state in rates or equation.state in e.couples",
        "equation.state in e.couples",
    ),
    "a plant under way goes on without a number": (
        "plants/simulator.py",
        "        if failed >= 0:\n            state = list(self._place)",
        "        if False:\n            state = list(self._place)",
    ),
    "a simplification may change a hundredth": ("compiler/pipeline.py", "SAME = 1e-9", "SAME = 1e-2"),
    "the shortest name of a decay counts": ("models/training/loss.py", "max(fits, key=len)", "min(fits, key=len)"),
    "a decay counts for names that begin alike": (
        "models/training/loss.py",
        'or parameter.startswith(d + ".")',
        "or parameter.startswith(d)",
    ),
    "the gain of a loop beside its resonance": (
        "compiler/quantize.py",
        "[np.linspace(0, np.pi, BETWEEN), np.abs(np.angle(_poles(loops)))]",
        "[np.linspace(0, np.pi, BETWEEN)]",
    ),
    "memory of forty steps costs nothing": ("compiler/quantize.py", "if steps > 4 and", "if steps > 40 and"),
    "products one bit finer than their sum": ("compiler/quantize.py", "GUARD = 3", "GUARD = 1"),
    "of two cuts the dearer": ("compiler/dataflow/sums.py", "min((early, late)", "max((early, late)"),
    "a tail starts from rest": (
        "models/training/levenberg.py",
        "states=self.tails and i == 0",
        "states=False",
    ),
    "what is held out starts from the state of a tail": (
        "models/training/levenberg.py",
        "states=self.tails and i == 0",
        "states=self.tails",
    ),
    "the state that shooting found is forgotten": (
        "models/training/levenberg.py",
        "initial={**r.initial, **i}",
        "initial=r.initial",
    ),
    "variances as if nothing had been fitted": (
        "mismatch/fit.py",
        "meat = scores.T @ scores * n / max(n - k, 1)",
        "meat = scores.T @ scores",
    ),
    "a slope is taken beyond its bound": (
        "mismatch/fit.py",
        "size *= -1 if value + size > u.high else 1",
        "pass",
    ),
    "a step goes beyond its bound": ("mismatch/fit.py", "return np.clip(step, *self.room.T)", "return step"),
    "a plan is not moved on": ("control/predictive.py", "self.plan = self._moved_on @ self.plan", "pass"),
    "the calibrated plant is not taken back to its data sheet": (
        "mismatch/claims.py",
        "    claims.calibrated = again\n",
        "",
    ),
    "its fit is not taken back to its data sheet": (
        "mismatch/claims.py",
        "        claims.fit = again\n    claims",
        "        pass\n    claims",
    ),
}


def sources() -> list[Path]:
    return sorted(p for f in PRODUCT for p in (ROOT / f).rglob("*.py"))


def named() -> list[Mutant]:
    """Those that have survived once, each by the reason why it should not."""
    found = []
    for name, (file, old, new) in NAMED.items():
        source = (ROOT / file).read_bytes()
        if source.count(old.encode()) != 1:
            raise SystemExit(
                f"mutant {name!r}: {old!r} stands {source.count(old.encode())} times in {file}; mend NAMED"
            )
        found.append(Mutant(file, source.index(old.encode()), old, new, name))
    return found


NEGATED = {"<": ">=", "<=": ">", ">": "<=", ">=": "<", "==": "!=", "!=": "==", "in": "not in", "not in": "in"} | {
    "is": "is not",
    "is not": "is",
}
BOUNDARY = {"<": "<=", "<=": "<", ">": ">=", ">=": ">"}  # of whole numbers; measured ones are never equal
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
                    self.between(left, right, NEGATED, "comparison")
                    if _is_whole(left) or _is_whole(right):
                        self.between(left, right, BOUNDARY, "comparison")
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


def _is_whole(node: ast.AST) -> bool:
    """A whole number, as far as its text tells."""
    match node:
        case ast.Constant(value=value):
            return type(value) is int
        case ast.Call():
            return _called(node) == "len"
    return isinstance(node, ast.Attribute) and node.attr in ("size", "width", "frac", "lo", "hi", "shift", "samples")


def _called(node: ast.Call) -> str:
    return getattr(node.func, "attr", getattr(node.func, "id", ""))


def drawn(count: int, seed: int) -> list[Mutant]:
    """`count` mutants, as many from every area, no two on one line."""
    rng = random.Random(seed)
    found: dict[str, dict[str, list[Mutant]]] = {area: {} for area in AREAS}
    for path in sources():
        file = path.relative_to(ROOT).as_posix()
        lines = found[max((a for a in AREAS if file.startswith(f"{a}/")), key=len)]
        for m in Draw(file).found:
            lines.setdefault(m.name.partition(" ")[0], []).append(m)
    areas = []
    for lines in found.values():
        shuffled = sorted(lines)
        rng.shuffle(shuffled)
        areas.append([rng.choice(sorted(lines[line], key=lambda m: m.key)) for line in shuffled[:count]])
    ranks = max(map(len, areas), default=0)
    in_turn = (area[k] for k in range(ranks) for area in areas if k < len(area))
    return list(islice(filter(_parses, in_turn), count))


def _parses(mutant: Mutant) -> bool:
    with suppress(SyntaxError):
        return bool(ast.parse(mutant.text((ROOT / mutant.file).read_bytes())))
    return False
