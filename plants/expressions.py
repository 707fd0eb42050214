"""Expressions: every text in a file that is to be computed becomes a checked tree here.

`parse` turns a text into a tree of numbers, names, `+ - * / **` and the functions of `functions.py`, or refuses it in
one line. A tree is evaluated on arrays (`Expression.over`) and written out as source (`Expression.source`). The text
itself is data: it is never evaluated, and never pasted into source. This holds for every origin of a text: a plant
file, a table of effects, a diagnosis, or this package.
"""

import keyword
import math
import operator
import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from operator import itemgetter
from typing import NoReturn

import numpy as np

from greygate.errors import InputError, shown
from greygate.plants.functions import FUNCTIONS, arguments, when

# The longest expression of any plant, effect or closure here has 260 characters, 100 nodes and a depth of 15. A much
# larger one is a table in disguise, or an attack: Python and numba recurse over the tree.
TEXT = 4000  # characters
NODES = 1000  # numbers, names, operations and calls
DEPTH = 100  # of nested operations, calls and brackets
NAME = 200  # characters of a name
WHOLE = 1 << 16  # up to this, whole numbers stay whole in the source: numba multiplies for x**2, takes logs for x**2.0

_SPACE = re.compile(r"(?:[ \t\r\n]++|#[^\r\n]*+)*+")  # and comments
_TOKEN = re.compile(
    r"(?P<number>(?>(?:(?:0|[1-9][0-9]*+)(?:\.[0-9]*+)?+|\.[0-9]++)(?:[eE][+-]?[0-9]++)?+)(?![A-Za-z0-9_.]))"
    r"|(?P<name>[A-Za-z_][A-Za-z0-9_]*+)|(?P<sign>\*\*|[-+*/(),])"
)
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
_RESERVED = {"np", *FUNCTIONS}
_SUM, _PRODUCT, _SIGN, _POWER, _ATOM = range(1, 6)  # how tightly an operation binds
_TEST, _COMPARISON = -1, 0  # `x if c != 0.0 else 0.0` binds less
_BINDS = {"+": _SUM, "-": _SUM, "*": _PRODUCT, "/": _PRODUCT, "**": _POWER}


def is_name(text) -> bool:
    """Whether it is a name for a term, an equation or an effect: ASCII letters, digits and _, with a letter first."""
    return isinstance(text, str) and len(text) <= NAME and _NAME.fullmatch(text) is not None


def check_name(value, where: str) -> str:
    """A kind (`greygate.reading`): a name as `is_name` has it."""
    if not is_name(value):
        raise InputError(f"{where} {shown(value)} is not a name; use ASCII letters, digits and underscores")
    return value


def is_symbol(text) -> bool:
    """Whether it is a name for a quantity in expressions and generated source: no keyword, no name of a function."""
    return is_name(text) and not keyword.iskeyword(text) and text not in _RESERVED


def check_symbol(value, where: str) -> str:
    """A kind (`greygate.reading`): a symbol as `is_symbol` has it."""
    if not is_symbol(value):
        raise InputError(
            f"{where} {shown(value)} is not a name for a quantity; use ASCII letters, digits and underscores"
        )
    return value


def check_expression(value, where: str) -> str:
    """A kind (`greygate.reading`): the text of an expression."""
    try:
        parse(value)
    except InputError as error:
        raise InputError(f"{where}: {error}") from None
    return value


# -- the tree --------------------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Number:
    """A finite number, 0 or more."""

    value: int | float


@dataclass(frozen=True, slots=True)
class Name:
    """The quantity of a symbol."""

    symbol: str


@dataclass(frozen=True, slots=True)
class Signed:
    """`sign` (+ or -) before a quantity."""

    sign: str
    of: "Node"


@dataclass(frozen=True, slots=True)
class Operation:
    """`left` and `right` joined by one of + - * / **. constant: its value if it contains no name."""

    sign: str
    left: "Node"
    right: "Node"
    constant: float | None = field(default=None, compare=False)


@dataclass(frozen=True, slots=True)
class Call:
    """A function of `arguments`, in the number that it takes. constant: its value if it contains no name."""

    function: str
    arguments: tuple["Node", ...]
    constant: float | None = field(default=None, compare=False)


Node = Number | Name | Signed | Operation | Call


@dataclass(frozen=True)
class Expression:
    """A checked expression. names: its symbols, in their order. over: scope (symbol -> value) -> its value.

    The arithmetic is that of IEEE, as in the compiled simulation: 1 / 0 is inf, (-8)**0.5 is nan.
    """

    tree: Node
    names: tuple[str, ...]
    over: Callable[[Mapping], np.ndarray | float] = field(compare=False, repr=False)

    def __str__(self) -> str:
        """The expression on one line, with only the brackets that it needs."""
        return _written(self.tree, _TEST, False)

    @property
    def condition(self) -> "Expression | None":
        """The condition under which it is not 0, where it is a `when` as a whole."""
        match self.tree:
            case Call("when", (condition, _)):
                return Expression(condition, tuple(names_of(condition)), _quiet(_computed(condition)))
        return None

    @property
    def chosen(self) -> "Expression":
        """What it is under its `condition`."""
        match self.tree:
            case Call("when", (_, value)):
                return Expression(value, tuple(names_of(value)), _quiet(_computed(value)))
        return self

    def source(self) -> str:
        """The expression in Python for numba; the x of `when(c, x)` is computed only where c is not 0."""
        return _written(self.tree, _TEST, True)


def parse(text: str) -> Expression:
    """Parse a text. Raises InputError in one line, without the place of the text, which the caller adds."""
    if not isinstance(text, str):
        raise InputError(f"{shown(text)} is not an expression in quotes; write one")
    if len(text) > TEXT:
        raise InputError(f"{shown(text)} has {len(text)} characters, at most {TEXT} are allowed; split it into terms")
    return _parsed(text)


@lru_cache(maxsize=16384)
def _parsed(text: str) -> Expression:
    parser = _Parser(text)
    tree = parser.whole()
    return Expression(tree, tuple(parser.names), _quiet(_computed(tree)))


def names(expressions: Iterable[str]) -> set[str]:
    """All names in the expressions."""
    return {name for text in expressions for name in parse(text).names}


def replaced(text: str, by: Mapping[str, str]) -> str:
    """The text of an expression in which some names are replaced by other names or by numbers."""
    parse(text)
    return _TOKEN.sub(lambda token: by.get(token[0], token[0]) if token["name"] else token[0], text)


def summands(text: str) -> list[tuple[str, str]]:
    """(the name of which it is a multiple, empty where there is none; its text) of every summand of an expression."""

    def parts(node: Node) -> list[Node]:
        return parts(node.left) + parts(node.right) if isinstance(node, Operation) and node.sign == "+" else [node]

    def factor(node: Node) -> str:
        match node:
            case Name(symbol):
                return symbol
            case Signed(_, of):
                return factor(of)
            case Operation("*" | "/", left, _):
                return factor(left)
        return ""

    return [(factor(part), _written(part, _TEST, False)) for part in parts(parse(text).tree)]


# -- from text to tree -----------------------------------------------------------------------------------------------


def _after_space(text: str, at: int) -> int:
    found = _SPACE.match(text, at)
    assert found, "it matches no space too"
    return found.end()


class _Parser:
    """Parses one text; `names` holds its symbols, in their order."""

    def __init__(self, text: str):
        self.text, self.nodes = text, 0
        self.names: dict[str, None] = {}
        self.tokens, self.at = self._tokens(), 0

    def fail(self, problem: str) -> NoReturn:
        raise InputError(f"{shown(self.text.strip())} {problem}")

    def _tokens(self) -> list[tuple[str, str]]:
        """(kind, text) of each token, and an empty one at the end."""
        found: list[tuple[str, str]] = []
        at = _after_space(self.text, 0)
        while at < len(self.text):
            token = _TOKEN.match(self.text, at)
            if token is None:
                self.fail("is not arithmetic; use numbers, names, + - * / ** and the known functions")
            assert token.lastgroup, "each alternative is a group with a name"
            found.append((token.lastgroup, token[0]))
            at = _after_space(self.text, token.end())
        return [*found, ("end", "")]

    def whole(self) -> Node:
        tree, _ = self.parsed(_SUM, DEPTH)
        if self.tokens[self.at][0] != "end":
            self.unexpected()
        return tree

    def unexpected(self):
        token = self.tokens[self.at][1]
        self.fail(f"is no expression ({f'{shown(token)} stands where it cannot' if token else 'it ends too early'})")

    def taken(self, sign: str) -> bool:
        """Whether the next token is `sign`; if so, it is consumed."""
        found = self.tokens[self.at] == ("sign", sign)
        self.at += found
        return found

    def parsed(self, binding: int, room: int) -> tuple[Node, int]:
        """(node, depth) of an operand that binds at least as tightly as `binding`. room: its greatest depth."""
        node, depth = self.first(room)
        while (sign := self.tokens[self.at][1]) in _BINDS and _BINDS[sign] >= binding:
            self.at += 1
            other, below = self.parsed(_SIGN if sign == "**" else _BINDS[sign] + 1, room - 1)
            node = self.counted(Operation(sign, node, other, _constant(node, other, of=_SIGNS[sign])))
            depth = 1 + max(depth, below)
            if depth > room:
                self.deep()
        return node, depth

    def first(self, room: int) -> tuple[Node, int]:
        """(node, depth) of a number, a name, a call, a bracket, or a sign with its operand."""
        if room < 1:
            self.deep()
        kind, token = self.tokens[self.at]
        if kind == "number":
            self.at += 1
            return self.counted(Number(self.number(token))), 1
        if kind == "name":
            self.at += 1
            return self.call(token, room) if self.taken("(") else (self.counted(self.name(token)), 1)
        if self.taken("("):
            node, depth = self.parsed(_SUM, room - 1)
            if not self.taken(")"):
                self.unexpected()
            return node, depth
        if self.taken("-") or self.taken("+"):
            node, depth = self.parsed(_SIGN, room - 1)
            return self.counted(Signed(token, node)), depth + 1
        return self.unexpected()

    def call(self, function: str, room: int) -> tuple[Node, int]:
        if function not in FUNCTIONS:
            raise InputError(f"unknown function {shown(function)}; known are {', '.join(FUNCTIONS)}")
        given: list[Node] = []
        depths = [0]
        while not given or self.taken(","):
            node, depth = self.parsed(_SUM, room - 1)
            given.append(node)
            depths.append(depth)
        if not self.taken(")"):
            self.unexpected()
        if len(given) != (wanted := arguments(function)):
            raise InputError(f"{function} takes {wanted} arguments, but {shown(self.text)} gives {len(given)}")
        node = Call(function, tuple(given), _constant(*given, of=FUNCTIONS[function]))
        return self.counted(node), 1 + max(depths)

    def name(self, token: str) -> Name:
        if not is_symbol(token):
            why = "a function needs its arguments" if token in FUNCTIONS else "it is no name for a quantity"
            raise InputError(f"unknown name {shown(token)}; {why}")
        self.names[token] = None
        return Name(token)

    def number(self, token: str) -> int | float:
        value = float(token)
        if not math.isfinite(value):
            self.fail(f"has a number {shown(token)} that is too large; write one below 1e308")
        return int(token) if token.isdigit() and value <= WHOLE else value

    def counted(self, node: Node) -> Node:
        self.nodes += 1
        if self.nodes > NODES:
            self.fail(f"has more than {NODES} numbers, names and operations; split it into terms")
        if isinstance(node, Operation | Call) and node.constant is not None and not math.isfinite(node.constant):
            self.fail("holds a constant that is not finite; mend that number")
        return node

    def deep(self):
        self.fail(f"is nested deeper than {DEPTH}; split it into terms or definitions")


# -- what a tree says ------------------------------------------------------------------------------------------------


def _divided(a, b):
    try:
        return a / b
    except ZeroDivisionError:
        return np.float64(a) / np.float64(b)


def _raised(a, b):
    try:
        power = a**b
    except (ZeroDivisionError, OverflowError):
        power = np.float64(a) ** np.float64(b)
    return np.nan if isinstance(power, complex) else power


_SIGNS = {"+": operator.add, "-": operator.sub, "*": operator.mul, "/": _divided, "**": _raised}


def names_of(node: Node) -> dict[str, None]:
    """The symbols of a tree, in their order."""
    match node:
        case Name(symbol):
            return {symbol: None}
        case Signed(_, of):
            return names_of(of)
        case Operation(_, left, right):
            return names_of(left) | names_of(right)
        case Call(_, given):
            return {name: None for argument in given for name in names_of(argument)}
    return {}


def _value(node: Node) -> float | None:
    """The value of a tree without names."""
    match node:
        case Number(value):
            return float(value)
        case Signed(sign, of):
            inner = _value(of)
            return -inner if sign == "-" and inner is not None else inner
        case Operation() | Call():
            return node.constant
    return None


def _constant(*parts: Node, of: Callable) -> float | None:
    """`of` the values of the parts, as floats, since powers of integers may be huge; None if a part has a name."""
    values = [_value(part) for part in parts]
    if None in values:
        return None
    with np.errstate(all="ignore"):
        return float(of(*values))


def _quiet(compute: Callable[[Mapping], np.ndarray | float]) -> Callable[[Mapping], np.ndarray | float]:
    """The same function without NumPy's warnings: 1 / 0 is inf here, as in the compiled simulation."""

    def over(scope: Mapping) -> np.ndarray | float:
        with np.errstate(all="ignore"):
            return compute(scope)

    return over


def _computed(node: Node) -> Callable[[Mapping], np.ndarray | float]:
    """The function scope -> value of a tree."""
    match node:
        case Number(value):
            return lambda scope: value
        case Name(symbol):
            return itemgetter(symbol)
        case Signed(sign, of):
            inner = _computed(of)
            return (lambda scope: -inner(scope)) if sign == "-" else (lambda scope: +inner(scope))
    if node.constant is not None:
        constant = node.constant
        return lambda scope: constant
    if isinstance(node, Operation):
        join, left, right = _SIGNS[node.sign], _computed(node.left), _computed(node.right)
        return lambda scope: join(left(scope), right(scope))
    function, given = FUNCTIONS[node.function], [_computed(argument) for argument in node.arguments]
    if node.function == "when":
        return _lazily(*given)
    return lambda scope: function(*(argument(scope) for argument in given))


def _lazily(condition: Callable, x: Callable) -> Callable[[Mapping], np.ndarray | float]:
    """`when(condition, x)`, whose x is computed only where the condition holds anywhere."""

    def over(scope: Mapping) -> np.ndarray | float:
        holds = condition(scope)
        return when(holds, x(scope)) if np.any(holds) else np.zeros(np.shape(holds))[()]

    return over


def _written(node: Node, around: int, source: bool) -> str:
    """The text of a node inside an operation that binds as tightly as `around`. source: for numba, else for `parse`."""
    match node:
        case Number(value):
            return repr(value)
        case Name(symbol):
            return symbol
        case Signed(sign, of):
            binding, text = _SIGN, sign + _written(of, _SIGN, source)
        case Operation(sign, left, right):
            binding = _BINDS[sign]
            if source:
                left, right = _floats(left, right)
            sides = (binding + 1, binding) if sign == "**" else (binding, binding + 1)
            text = f"{_written(left, sides[0], source)} {sign} {_written(right, sides[1], source)}"
        case Call("when", (condition, value)) if source:
            compared = f"{_written(condition, _COMPARISON + 1, source)} != 0.0"
            binding, text = _TEST, f"{_written(value, _TEST + 1, source)} if {compared} else 0.0"
        case Call(function, given):
            given = _floats(*given) if source else given
            binding, text = _ATOM, f"{function}({', '.join(_written(argument, _TEST, source) for argument in given)})"
    return f"({text})" if around > binding else text


def _floats(*nodes: Node) -> tuple[Node, ...]:
    """The nodes; if all are whole numbers, as floats, with which numba's arithmetic does not overflow."""
    made = tuple(found for node in nodes if (found := _float(node)) is not None)
    return made if len(made) == len(nodes) else nodes


def _float(node: Node) -> Node | None:
    """A whole number, signed or not, as a float; None for any other node."""
    match node:
        case Number(int(value)):
            return Number(float(value))
        case Signed(sign, of) if (made := _float(of)) is not None:
            return Signed(sign, made)
    return None
