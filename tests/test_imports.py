"""The order of the house: imports point down and never in a circle; a machine is named in its own folder alone.

The imports are read from the source, those inside functions too.
"""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from rooms import ROOT, imports, layer, modules

CONCEALED = "mismatch/concealed"  # an independent second implementation of four machines, as a referee
WORDS = {  # of machines and their parts
    *("asymmetric", "belt", "belts", "cable", "carriage", "chamber", "chambers", "crane", "cylinder", "cylinders"),
    *("drum", "drums", "leakage", "pendulum", "piston", "pistons", "pulley", "pump", "pumps", "slip", "spool"),
    *("tanks", "transmission", "valve", "valves"),
}
PLAIN = {"measured", "benchmark_systems"}  # folders whose names are words of every day


def test_imports_point_down():
    up = []
    for name, targets in imports().items():
        for target in targets:
            (own, folder), (other, there) = layer(name), layer(target)
            if folder != there and other <= own:
                up.append(f"{name} imports {target}")
    assert not up


def test_no_module_imports_itself_by_way_of_others():
    reached: dict[str, set[str]] = {name: set(targets) for name, targets in imports().items()}
    for between in reached:
        for targets in reached.values():
            if between in targets:
                targets |= reached[between]
    assert not [name for name, targets in reached.items() if name in targets]


STARTS = re.compile(  # ways to start a process
    r"import (subprocess|multiprocessing|pty)\b|from (subprocess|multiprocessing|pty)\b|\bProcessPoolExecutor\b"
    r"|joblib\.Parallel|from joblib import|\bos\.(fork|forkpty|exec|spawn|posix_spawn|system|popen)\w*\("
    r"|\bsys\.executable\b"
)


def test_processes_are_started_in_one_place():
    """`greygate/children.py` isolates them and ends them. Verilator's simulation is told which Python it embeds."""
    found = {
        name: lines
        for name, path in modules().items()
        if (lines := [m[0] for m in STARTS.finditer(path.read_text(encoding="utf-8"))])
    }
    del found["greygate.children"], found["greygate.system"]  # which has what systems differ in, and is asked there
    trees = [n for n, path in modules().items() if re.search(r"\bTree\(", path.read_text(encoding="utf-8"))]
    assert trees == ["greygate.children"]
    assert found == {"greygate.hardware.verify": ["sys.executable"]}


def general() -> list[Path]:
    """Files of code that knows no machine."""
    files = [path for path in modules().values() if path.relative_to(ROOT).parts[0] != "machines"]
    return [path for path in files if not path.relative_to(ROOT).as_posix().startswith(CONCEALED)]


@cache
def machine_names() -> set[str]:
    """Of folders and of plants."""
    folders = {path.parent.name for path in (ROOT / "machines").glob("*/__init__.py")}
    return folders - PLAIN | {path.stem for path in (ROOT / "machines").glob("*/*.toml")}


def written(tree: ast.AST) -> Iterator[tuple[int, str, bool]]:
    """(line, text, whether it is a docstring) of every identifier and string."""
    docs = {
        id(node.body[0].value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef)
        and ast.get_docstring(node, clean=False) is not None
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.lineno, node.value, id(node) in docs
        for field in ("id", "attr", "arg", "name", "module", "asname"):
            if isinstance(text := getattr(node, field, None), str):
                yield getattr(node, "lineno", 0), text, False


@cache
def named(text: str, doc: bool) -> set[str]:
    """Names of machines in the text; of an identifier or a string that is no docstring, words for their parts too."""
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", text).lower()
    phrases = " ".join(re.findall(r"[a-z0-9]+", spaced))
    found = {name for name in machine_names() if f" {name.replace('_', ' ')} " in f" {phrases} "}
    return found if doc else found | (WORDS & set(phrases.split()))


def test_general_code_names_no_machine():
    found = []
    for path in general():
        for line, text, doc in written(ast.parse(path.read_text(encoding="utf-8"))):
            found += [f"{path.relative_to(ROOT)}:{line}: {name}" for name in named(text, doc)]
    assert not found


@pytest.mark.parametrize(
    ("text", "names"),
    [("class BeltDrive", {"belt", "belt_drive"}), ("slip_sum", {"slip"}), ("slipped, a driver, pumped", set())],
)
def test_a_name_is_found_as_a_whole_word_in_any_spelling(text, names):
    assert named(text, doc=False) == names
