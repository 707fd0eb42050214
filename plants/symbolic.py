"""Plants and sympy: a declaration with sympy expressions in it, and a plant's equations as sympy or as LaTeX.

sympy is no part of a plain installation: `pip install 'greygate[symbolic]'`.
"""

import operator
import re
from collections.abc import Mapping, Sequence
from types import ModuleType
from typing import Any

from greygate.errors import InputError, brought_by, shown
from greygate.plants.expressions import Call, Name, Node, Number, Operation, Signed, check_expression, parse
from greygate.plants.plant import Plant

_WRITTEN = {"Abs": "abs", "sign": "sign", "Min": "min", "Max": "max", "log": "log", "exp": "exp", "atan2": "atan2"} | {
    name: name for name in ("sin", "cos", "tan", "atan", "tanh")
}  # class in sympy -> function in an expression
_READ = {"abs": "Abs", "min": "Min", "max": "Max"}  # and back, where they differ
_JOINED = {"+": operator.add, "-": operator.sub, "*": operator.mul, "/": operator.truediv, "**": operator.pow}
_ABOVE, _BELOW = ("StrictGreaterThan", "GreaterThan"), ("StrictLessThan", "LessThan")


def sympy_module() -> ModuleType:
    with brought_by("symbolic", "sympy"):
        import sympy
    return sympy


# -- from sympy ------------------------------------------------------------------------------------------------------


def texts(declaration: Any) -> Any:
    """A declaration for `Plant.of` in which sympy expressions stand for texts, with their texts.

    Names of symbols are the plant's names. Raises InputError for what an expression of a plant cannot say.

    >>> import sympy
    >>> h, k = sympy.symbols("h k")
    >>> texts({"h": {"outflow": -k * sympy.sqrt(sympy.Max(h, 0))}})
    {'h': {'outflow': '-k*sqrt(max(0, h))'}}
    """
    sympy = sympy_module()
    if isinstance(declaration, Mapping):
        return {str(name): texts(value) for name, value in declaration.items()}
    if isinstance(declaration, list | tuple):
        return [texts(value) for value in declaration]
    if isinstance(declaration, sympy.Basic):
        return written(declaration)
    return declaration


def written(expression: Any) -> str:
    """The text of a sympy expression. Raises InputError for what an expression of a plant cannot say."""
    sympy = sympy_module()
    if expression.free_symbols and not all(isinstance(s, sympy.Symbol) for s in expression.free_symbols):
        raise InputError(f"{shown(str(expression))}: only symbols can stand for quantities")

    class Printer(sympy.printing.str.StrPrinter):  # type: ignore[name-defined]
        def _print_Function(self, e: Any) -> str:
            name = _WRITTEN.get(type(e).__name__)
            if name is None:
                _cannot(e)
            if name in ("min", "max") and len(e.args) > 2:
                return f"{name}({self._print(e.args[0])}, {self._print(e.func(*e.args[1:]))})"
            return f"{name}({', '.join(map(self._print, e.args))})"

        _print_Abs = _print_sign = _print_Min = _print_Max = _print_log = _print_exp = _print_Function

        def _print_Piecewise(self, e: Any) -> str:
            out = self._print(e.args[-1].expr)
            if e.args[-1].cond != sympy.true:
                _cannot(e)
            for piece in reversed(e.args[:-1]):
                holds = self._holds(piece.cond)
                out = f"(when({holds}, {self._print(piece.expr)}) + when(1.0 - {holds}, {out}))"
            return out

        def _holds(self, condition: Any) -> str:
            kind = type(condition).__name__
            if kind not in (*_ABOVE, *_BELOW):
                _cannot(condition)
            first, last = condition.args if kind in _ABOVE else reversed(condition.args)
            above = f"max(sign({self._print(first - last)}), 0.0)"
            return above if kind.startswith("Strict") else f"(1.0 - max(sign({self._print(last - first)}), 0.0))"

        def _print_Heaviside(self, e: Any) -> str:
            return f"(0.5 + 0.5*sign({self._print(e.args[0])}))"

        def emptyPrinter(self, e: Any) -> str:
            return _cannot(e)

    text = Printer({"full_prec": True}).doprint(sympy.sympify(expression).replace(sympy.pi, sympy.Float(sympy.pi)))
    return check_expression(text, f"{shown(str(expression))}, written {shown(text)}")


def _cannot(expression: Any) -> str:
    raise InputError(f"{shown(str(expression))}: no expression of a plant says this; known: {', '.join(_WRITTEN)}")


def balances(mass: Any, forces: Sequence[Mapping[str, Any]], rates: Sequence[str]) -> dict[str, dict]:
    """Equations for `Plant.of` of mass * d(rates)/dt = sum of forces, as sympy's Lagrangian mechanics gives them.

    mass: a symmetric matrix (n, n). forces: for each row, name of a term -> expression. rates: names of the states.

    >>> import sympy
    >>> c = sympy.Symbol("c")
    >>> balances(sympy.Matrix([[2, c], [c, 1]]), [{"drive": c}, {"weight": -c}], ["v", "w"])["balance_v"]
    {'v': {'storage': '2', 'couples': {'w': 'c'}, 'drive': 'c'}}
    """
    n = len(rates)
    if mass.shape != (n, n) or len(forces) != n:
        raise InputError(f"mass {mass.shape}, {len(forces)} forces, {n} rates; give as many of each")
    out = {}
    for i, rate in enumerate(rates):
        couples = {other: written(mass[i, j]) for j, other in enumerate(rates) if j != i and mass[i, j] != 0}
        out[f"balance_{rate}"] = {rate: {"storage": written(mass[i, i]), "couples": couples, **texts(forces[i])}}
    return out


# -- to sympy --------------------------------------------------------------------------------------------------------


def symbolic(expression: str) -> Any:
    """The text of an expression as a sympy expression, in sympy's order of factors."""
    return _made(parse(expression).tree, sympy_module())


def _made(node: Node, sympy: ModuleType) -> Any:
    match node:
        case Number(value):
            return sympy.Integer(int(value)) if float(value).is_integer() else sympy.Float(value, 6)
        case Name(symbol):
            return sympy.Symbol(symbol)
        case Signed(sign, inner):
            return -_made(inner, sympy) if sign == "-" else _made(inner, sympy)
        case Operation(sign, left, right):
            return _JOINED[sign](_made(left, sympy), _made(right, sympy))
        case Call("when", (condition, value)):
            return sympy.Piecewise((_made(value, sympy), sympy.Ne(_made(condition, sympy), 0)), (0, True))
        case Call("smooth_step", (x, width)):
            return (1 + sympy.tanh(_made(x, sympy) / _made(width, sympy))) / 2
        case Call("orifice", given):
            u, p, q = (_made(g, sympy) for g in given)
            return sympy.Max(u, 0) * sympy.sign(p - q) * sympy.sqrt(sympy.Abs(p - q))
        case Call(name, given):
            return getattr(sympy, _READ.get(name, name))(*(_made(g, sympy) for g in given))
    raise AssertionError(node)


def latex(plant: Plant, names: bool = True) -> str:
    r"""The plant's equations in LaTeX, one line each, for an `align` environment; needs sympy.

    names: with the name of each term under it, where a sum has more than one.

    >>> print(latex(axis, names=False))
    \begin{align}
    \dot{x} &= v \\
    \mathrm{mass} \, \dot{v} &= \mathrm{force} - v \mathrm{viscous}
    \end{align}
    """
    sympy = sympy_module()

    def shown_(text: str) -> str:
        found = symbolic(text)
        return sympy.latex(found, symbol_names={s: _symbol(s.name, sympy.latex(s)) for s in found.free_symbols})

    def summed(terms: Mapping[str, str]) -> str:
        out = ""
        for term, text in terms.items():
            part = shown_(text)
            minus, part = ("-", part[1:].strip()) if part.startswith("-") and _single(symbolic(text)) else ("+", part)
            if names and len(terms) > 1:
                label = term.replace("_", r"\_")
                part = rf"\underbrace{{{part}}}_{{\text{{{label}}}}}"
            out += (f" {minus} " if out else "-" * (minus == "-")) + part
        return out or "0"

    def rate(state: str, factor: str) -> str:
        dot = rf"\dot{{{shown_(state)}}}"
        return dot if factor in ("1", "1.0") else rf"{_bracketed(factor, shown_(factor))} \, {dot}"

    lines = [f"{shown_(d.symbol)} &= {summed(d.terms)}" for d in plant.definitions.values()]
    for equation in plant.equations.values():
        left = [rate(equation.state, equation.storage), *(rate(s, f) for s, f in equation.couples.items())]
        lines.append(f"{' + '.join(left)} &= {summed(equation.terms)}")
    return "\n".join([r"\begin{align}", " \\\\\n".join(lines), r"\end{align}"])


def _single(expression: Any) -> bool:
    """Whether a sign before the expression is that of all of it."""
    return not expression.is_Add


def _symbol(name: str, plain: str) -> str:
    """A name in LaTeX: one letter or a Greek one as it is, a word upright; what follows `_` is an index."""
    head, *index = re.split("_", name)
    first = plain.partition("_")[0] if plain.startswith("\\") or len(head) == 1 else rf"\mathrm{{{head}}}"
    return first + (rf"_{{{', '.join(filter(None, index))}}}" if any(index) else "")


def _bracketed(text: str, shown_: str) -> str:
    tree = parse(text).tree
    return rf"\left({shown_}\right)" if isinstance(tree, Operation) and tree.sign in "+-" else shown_
