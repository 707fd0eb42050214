"""Expressions are data: a text becomes a checked tree or is refused at once, wherever it stands."""

import ast
import json
import re
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sweeping import every

from greygate.errors import InputError
from greygate.mismatch import effects as table
from greygate.mismatch.simulation import check
from greygate.plants.expressions import DEPTH, NODES, TEXT, Number, is_name, is_symbol, parse, replaced
from greygate.plants.functions import FUNCTIONS, arguments
from greygate.plants.plant import Parameter, Plant, Values
from greygate.plants.simulator import source

ROOT = Path(__file__).parent.parent
PACKAGES = ("greygate", "models", "compiler", "emulator", "rtl", "plants", "mismatch", "control", "machines")
AT_ONCE = 0.5  # s; a refusal takes a millisecond, the rest is a busy machine

CANARY = "canary_of_greygate"  # a file that no text may make
OPEN = f"open('{CANARY}', 'w')"
HOSTILE = {
    "the class walk": "().__class__.__base__.__subclasses__()[0]",
    "the class walk to a shell": f"[c for c in ().__class__.__base__.__subclasses__() if c.__name__ == '_wrap_close']"
    f"[0].__init__.__globals__['system']('touch {CANARY}')",
    "a big number": "0*9**9**9",
    "a bigger number": "9**9**9**9**9",
    "a large literal": "1e999",
    "a long literal": "1" + "0" * 400,
    "a power beyond floats": "10^400",
    "a power that overflows": "10**400",
    "a constant by zero": "x + 1/0",
    "a root of a negative constant": "(-8)**0.5 * x",
    "nested minus signs": "-" * 900 + "x",
    "nested plus signs": "+" * 900 + "x",
    "nested brackets": "(" * 900 + "x" + ")" * 900,
    "nested calls": "sin(" * 700 + "x" + ")" * 700,
    "nested powers": "x**" * 900 + "x",
    "3000 terms": " + ".join(["x"] * 3000),
    "1500 short terms": "+".join(["x"] * 1500),
    "a broad tree": "+".join(["(x*x*x*x*x*x*x*x*x*x*x*x)"] * 90),
    "an open bracket": "(" * 4000,
    "digits": "9" * 3999,
    "a name without end": "x" * 3999,
    "a call of a builtin": OPEN,
    "an import": f"__import__('os').system('touch {CANARY}')",
    "an import statement": "import os",
    "eval": f'eval("{OPEN}")',
    "exec": f'exec("{OPEN}")',
    "a builtin by name": "__builtins__",
    "a dunder name": "__name__",
    "a private name": "_x",
    "the simulation's array": "_p",
    "numpy": "np.load('x')",
    "an attribute": "x.real",
    "an attribute of a number": "1.0.real",
    "a method": "x.dump('a')",
    "a subscript": "x[0]",
    "a slice": "x[::-1]",
    "a list": "[x]",
    "a tuple": "(x, x)",
    "an empty tuple": "()",
    "a set": "{x}",
    "a dict": "{1: x}",
    "a comprehension": "[x for x in range(9)]",
    "a generator": "sum(x for x in (1, 2))",
    "a lambda": "(lambda: x)()",
    "an f-string": "f'{x}'",
    "a string": "'x'",
    "bytes": "b'x'",
    "a template": "{{ x }}",
    "a walrus": "(y := x)",
    "an assignment": "y = x",
    "a condition": "x if x else x",
    "a comparison": "x < 1",
    "not": "not x",
    "and": "x and x",
    "a boolean": "True * x",
    "nothing": "None",
    "an ellipsis": "...",
    "a complex number": "1j * x",
    "a hexadecimal number": "0x10 * x",
    "a number with underscores": "1_000 * x",
    "Arabic digits": "\u0661\u0662 * x",
    "superscript": "x\u00b2",
    "a full-width name": "\uff4f\uff50\uff45\uff4e",
    "a mathematical letter": "\U0001d465",
    "a fraction slash": "x \u2044 2",
    "a full-width bracket": "sin\uff08x\uff09",
    "a no-break space": "x\u00a0+ x",
    "a line separator": "x\u2028+ x",
    "a right-to-left override": "x\u202e + x",
    "a null byte": "x\x00",
    "a backspace": "x\x08",
    "a form feed": "x\x0c+ x",
    "a second statement": f"x; {OPEN}",
    "a second line": f"x\n{OPEN}",
    "a second line after a carriage return": f"x\r{OPEN}",
    "a line joined": f"x \\\n + {OPEN}",
    "a comment before a line": f"x # harmless\n; {OPEN}",
    "a comment and a carriage return": f"x # harmless\r + {OPEN}",
    "a bracket closed too early": f"0) + {OPEN} + (0",
    "an argument smuggled in": "0, x",
    "a docstring": '"""x"""',
    "a keyword": "lambda",
    "a keyword argument": "sin(x=x)",
    "star arguments": "sin(*x)",
    "double star arguments": "sin(**x)",
    "too few arguments": "min(x)",
    "too many arguments": "sin(x, x)",
    "an empty call": "sin()",
    "a call of a number": "2(x)",
    "a call of a call": "sin(x)(x)",
    "a call of a symbol": "x(x)",
    "a function as a value": "sin",
    "another function": "print(x)",
    "await": "await x",
    "yield": "(yield x)",
    "floor division": "x // 2",
    "modulo": "x % 2",
    "matrix product": "x @ x",
    "shift": "x << 900000000",
    "bits": "~x",
    "two operands": "x x",
    "an operator too many": "x + * x",
    "an operator at the end": "x +",
    "nothing at all": "",
    "blanks": " \t\n",
}
BREAKS = re.compile(r"[\n\r\x0b\x0c\x1c-\x1e\x85\u2028\u2029]")


@pytest.fixture(autouse=True)
def canary(tmp_path, monkeypatch):
    """No test leaves the file that the hostile texts would make."""
    monkeypatch.chdir(tmp_path)
    yield tmp_path / CANARY
    assert not list(tmp_path.rglob(CANARY))


def refused(read, *text) -> str:
    """The one line in which `read` refuses, at once: the second time, since the first may fill caches."""
    spent = []
    for _ in range(2):
        began = time.process_time()
        with pytest.raises(InputError) as caught:
            read(*text)
        spent.append(time.process_time() - began)
    assert min(spent) < AT_ONCE
    message = str(caught.value)
    assert not BREAKS.search(message)
    assert len(message) < 500
    return message


# -- the parser ------------------------------------------------------------------------------------------------------


def test_the_parser_refuses_at_once():
    every(HOSTILE, lambda case: refused(parse, HOSTILE[case]))


@pytest.mark.parametrize("value", [0, 1, 1.0, True, b"x", ["x"], {"x": 1}, ("x",)])
def test_what_is_no_text_is_no_expression(value):
    refused(parse, value)


def test_an_expression_of_the_largest_size_is_computed_and_one_more_is_refused():
    deepest = "-" * (DEPTH - 1) + "x"
    assert parse(deepest).over({"x": 2.0}) == -2.0
    refused(parse, "-" + deepest)
    flat = "+".join(["x"] * DEPTH)
    assert parse(flat).over({"x": 1.0}) == DEPTH
    refused(parse, flat + "+x")
    groups = (NODES + 1) // 10
    broad = "+".join("(x+x+x+x+x)" for _ in range(groups // 2)), "+".join("(x+x+x+x+x)" for _ in range(groups // 2))
    assert parse(f"({broad[0]})*({broad[1]})").over({"x": 1.0}) == (5 * (groups // 2)) ** 2
    refused(parse, f"({broad[0]})*({broad[1]})*(x+x+x)")
    assert parse("x".ljust(TEXT)).names == ("x",)
    refused(parse, "x".ljust(TEXT + 1))


NUMBERS = st.one_of(
    st.integers(0, 50).map(str), st.floats(1e-9, 1e9, allow_nan=False).map(repr), st.sampled_from(["2.", ".5", "12e5"])
)
LEAVES = st.one_of(st.sampled_from(["x", "y", "mass"]), NUMBERS)
TREES = st.recursive(
    LEAVES,
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from(["+", "-", "*", "/", "**"]), inner).map(" ".join),
        st.tuples(st.sampled_from("+-"), inner).map("".join),
        inner.map("({})".format),
        st.tuples(st.sampled_from([n for n in FUNCTIONS if arguments(n) == 1]), inner).map(lambda t: f"{t[0]}({t[1]})"),
        st.tuples(inner, inner).map(lambda t: f"min({t[0]}, {t[1]})"),
        st.tuples(inner, inner).map(lambda t: f"when({t[0]}, {t[1]})"),
    ),
    max_leaves=12,
)


@given(TREES)
def test_an_expression_means_what_the_same_text_means_in_python(text):
    """Python's own parser is the oracle: brackets, signs, and what binds tighter."""
    try:
        found = parse(text)
    except InputError as error:
        assert "not finite" in str(error)  # noqa: PT017
        return
    plain = ast.unparse(ast.parse(text, mode="eval"))
    assert ast.dump(ast.parse(str(found), mode="eval")) == ast.dump(ast.parse(plain, mode="eval"))
    assert parse(str(found)) == found
    if "when" not in text:
        floats = re.sub(r"(?<![\w.])(\d+)\.0(?![\de])", r"\1", plain)
        assert re.sub(r"(?<![\w.])(\d+)\.0(?![\de])", r"\1", found.source()) == floats


@given(TREES)
def test_an_expression_computes_on_arrays_what_numpy_computes(text):
    scope = {"x": np.array([-2.0, 0.5, 3.0]), "y": np.array([1.0, 0.0, 2.5]), "mass": 1.5}
    try:
        found = parse(text)
    except InputError:
        return
    with np.errstate(all="ignore"):
        try:
            floats = re.sub(r"(?<![\w.])(?<!e[+-])(\d+)(?![\w.])", r"\1.0", text)  # 6**25 is no number of NumPy's
            wanted = eval(floats, {**FUNCTIONS, "__builtins__": {}}, scope)
        except (OverflowError, ZeroDivisionError):
            return  # Python's scalars; here they are as NumPy's
        if isinstance(wanted, complex) or np.iscomplexobj(wanted):
            return
        np.testing.assert_array_equal(found.over(scope), wanted)


def test_arithmetic_of_numbers_is_that_of_the_compiled_simulation():
    scope = {"zero": 0.0, "large": 1e200, "less": -8.0}
    for text, value in (("1 / zero", np.inf), ("large**2", np.inf), ("zero**(-1)", np.inf), ("less**0.5", np.nan)):
        np.testing.assert_equal(parse(text).over(scope), value)
    assert np.isnan(parse("zero / zero").over(scope))


def test_whole_numbers_stay_whole_beside_a_quantity_and_are_floats_among_themselves():
    assert parse("2 * x**3").source() == "2 * x ** 3"
    assert parse("2**3 * x").source() == "2.0 ** 3.0 * x"
    assert parse("abs(-3) * x").source() == "abs(-3.0) * x"
    assert parse("99999999999 * x").tree.left == Number(99999999999.0)


def test_what_stands_in_when_is_computed_only_where_its_condition_is():
    assert parse("2 * when(a, x + 1)").source() == "2 * (x + 1 if a != 0.0 else 0.0)"


def test_whole_names_are_replaced_and_no_part_of_one():
    text = "seen_low_u + seen_low_u_dot * 1e5 - e5"
    assert replaced(text, {"seen_low_u": "-0.5", "e5": "y"}) == "-0.5 + seen_low_u_dot * 1e5 - y"


@pytest.mark.parametrize("name", ["_x", "__x__", "if", "None", "sin", "np", "abs", "2x", "x y", "x\n", "ﬁ", "é", "", 3])
def test_what_python_or_the_simulation_means_by_a_name_is_no_symbol(name):
    assert not is_symbol(name)


# -- every entry -----------------------------------------------------------------------------------------------------

PLANT = """
outputs = ["y"]
inputs = {{ u = "1" }}
parameters = {{ k = [1.0, "1"] }}
[states]
x = {{ unit = "1"{bound} }}
[definitions.shown]
y = {{ unit = "1", state = "x"{definition} }}
[equations.motion]
x = {{ drive = "u"{term}{storage} }}
"""
WHERE = {
    "bound": ", low = {}",
    "term": ", other = {}",
    "storage": ", storage = {}",
    "definition": ", other = {}",
}


def toml(text: str) -> str:
    """As a TOML string."""
    return json.dumps(text, ensure_ascii=True).replace("\\ud835\\udc65", "\\U0001d465")


@pytest.mark.parametrize("where", [*WHERE, "initial", "high", "start"])
def test_a_plant_file_is_refused_with_each_hostile_text(where, tmp_path):
    key = where if where in WHERE else "bound"
    path = tmp_path / "mine.toml"

    def check(case):
        text = WHERE[key].format(toml(HOSTILE[case]))
        text = text.replace("low", where if key == "bound" and where != "bound" else "low")
        path.write_text(PLANT.format(**{**dict.fromkeys(WHERE, ""), key: text}))
        message = refused(Plant.read, path)
        assert message.startswith((f"{path}: ", "plant mine: "))
        assert not list(tmp_path.rglob(CANARY))

    every(HOSTILE, check)


EFFECT = {
    "means": "mine",
    "plants": ["mine"],
    "equations": ["motion"],
    "depends_on": ["x"],
    "parameters": {"own": {"unit": "1", "typical": 1.0}},
}
ENTRIES = {
    "term": lambda text: {"terms": {"motion.own": text}},
    "sensor": lambda text: {"terms": {"sensor_y.NAME": text}},
    "definition": lambda text: {"definitions": {"d": {"symbol": "s", "unit": "1", "sum": text}}},
    "start": lambda text: {"states": {"z": {"unit": "1", "start": text}}},
    "low": lambda text: {"states": {"z": {"unit": "1", "low": text}}},
    "balance": lambda text: {"equations_of": {"e": {"state": "z", "terms": {"t": text}}}},
    "storage": lambda text: {"equations_of": {"e": {"state": "z", "terms": {"t": "x"}, "storage": text}}},
    "filter": lambda text: {"filters": {"u": text}},
    "filter's symbol": lambda text: {"filters": {"u": f"delay {text}"}},
    "wave": lambda text: {"wave": {"w": ["own", text]}},
    "symbol": lambda text: {"parameters": {text: {"typical": 1.0}}},
    "state's symbol": lambda text: {"states": {text: {"unit": "1"}}},
    "definition's symbol": lambda text: {"definitions": {"d": {"symbol": text, "unit": "1", "sum": "x"}}},
    "definition's name": lambda text: {"definitions": {text: {"symbol": "s", "unit": "1", "sum": "x"}}},
    "equation's name": lambda text: {"states": {"z": {"unit": "1"}},
                                     "equations_of": {text: {"state": "z", "terms": {"t": "x"}}}},
    "place": lambda text: {"terms": {f"{text}.own": "own * x"}},
    "term's name": lambda text: {"terms": {f"motion.{text}": "own * x"}},
    "set": lambda text: {"set": {text: 1.0}},
    "freed": lambda text: {"parameters": {}, "frees": {text: {"typical": 1.0}}},
    "of": lambda text: {"of": text},
}  # fmt: skip


NAMED = ("definition's name", "equation's name", "term's name", "of")


@pytest.fixture(scope="module")
def plain(tmp_path_factory) -> Plant:
    path = tmp_path_factory.mktemp("plant") / "mine.toml"
    path.write_text(PLANT.format(**dict.fromkeys(WHERE, "")))
    return Plant.read(path)


@pytest.mark.parametrize("where", ENTRIES)
def test_a_table_of_effects_is_refused_with_each_hostile_text(where, plain, tmp_path):
    import tomli_w

    for case, text in HOSTILE.items():
        if where in NAMED and (is_name(text) or (where == "of" and not text)):
            continue  # no symbol: a place, a term or an effect may have this name
        path = tmp_path / "own.toml"
        path.write_text(tomli_w.dumps({"own": EFFECT | ENTRIES[where](text)}), encoding="utf-8")

        def made(path=path) -> None:
            source(table.join(plain, table.read(path).values())[0])

        assert "own" in refused(made), case


@pytest.mark.parametrize("where", ["place", "term", "symbol", "plain symbol"])
def test_a_diagnosis_is_refused_with_each_hostile_text(where):
    for text in HOSTILE.values():
        if where == "place" and is_name(text):
            continue  # is none of the plant's; `simulate` says so
        p = {"value": 1.0, "place": "motion", "term": "x"}
        symbol = text if "symbol" in where else "unknown_1"
        effects = [{"id": "unknown", "equations": ["motion"], "parameters": {symbol: p | {where: text}}}]
        found = {"schema": "diagnosis/1", "plant": "mine", "effects": effects, "parameters": {}}
        if where == "plain symbol":
            if is_name(text):
                continue  # is unknown to the plant; `simulate` says so
            found |= {"effects": [], "parameters": {text: {"value": 1.0}}}
        assert refused(check, found).startswith("diagnosis: ")


# -- nothing in the package evaluates text ---------------------------------------------------------------------------


def test_nothing_in_the_package_evaluates_or_compiles_text():
    """No `eval`, `exec`, `compile`, `__import__`, whether called or passed on, in any module of the package."""
    found = []
    for package in PACKAGES:
        for path in (ROOT / package).rglob("*.py"):
            for node in ast.walk(ast.parse(path.read_text())):
                if isinstance(node, ast.Name) and node.id in ("eval", "exec", "compile", "__import__"):
                    found.append(f"{path}:{node.lineno}")
                if isinstance(node, ast.Import) and any(
                    name.name in ("ast", "pickle", "marshal") for name in node.names
                ):
                    found.append(f"{path}:{node.lineno}")
    assert found == []


def test_values_of_a_long_chain_of_definitions_need_no_deep_stack(plain, tmp_path):
    lines = [f'[definitions.d{i}]\ny{i} = {{ unit = "1", t = "y{i - 1} + 1" }}' for i in range(1, 900)]
    path = tmp_path / "chain.toml"
    path.write_text('outputs = ["y899"]\n[inputs]\ny0 = "1"\n' + "\n".join(lines))
    plant = Plant.read(path)
    assert plant.values(["y899"], {"y0": np.zeros(2)})["y899"].tolist() == [899.0, 899.0]


def test_an_initial_value_that_is_not_finite_is_refused(plain):
    from dataclasses import replace

    from greygate.plants.plant import State

    plant = replace(plain, states={"x": State("1", "1 / k")}, parameters={"k": Parameter(0.0, "1")})
    assert "is inf" in refused(plant.initial)
    assert Values(plant, {"x": 1.0}).evaluate("1 / k") == np.inf
