"""A number in the general code of the diagnosis has a name, beside which its reason stands."""

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

from greygate import mismatch

FOLDER = Path(mismatch.__file__).parent  # its words.py lays out text, in which widths and digits are plain
PLAIN = (0, 1, 2)  # with either sign: numbers that need no name


def unnamed(tree: ast.Module) -> Iterator[ast.Constant]:
    """Numbers inside functions that are neither plain nor an index nor an exponent."""
    bodies = [node for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.Lambda)]
    exempt = set()
    for node in ast.walk(tree):
        places = [node.slice] if isinstance(node, ast.Subscript) else []
        places += [node.right] if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Pow) else []
        exempt |= {id(inner) for place in places for inner in ast.walk(place)}
    numbers = {id(n): n for body in bodies for n in ast.walk(body) if isinstance(n, ast.Constant)}
    for number in numbers.values():
        if type(number.value) in (int, float) and number.value not in PLAIN and id(number) not in exempt:
            yield number


def lines(path: Path) -> list[str]:
    return [f"line {n.lineno}: {n.value}" for n in unnamed(ast.parse(path.read_text(encoding="utf-8")))]


@pytest.mark.parametrize(
    "path",
    sorted(set(FOLDER.rglob("*.py")) - {FOLDER / "words.py"}),
    ids=lambda path: path.relative_to(FOLDER).as_posix(),
)
def test_no_function_has_a_number_without_a_name(path):
    assert lines(path) == []
