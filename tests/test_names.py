"""Names and units are checked where they enter, and every entry of a file with them."""

import copy
import csv
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import tomli_w
from command_line import greygate
from networks import delay_line
from programs import cylinder_program, random_program
from safetensors.numpy import load_file, save_file
from test_cli import recording

from greygate.emulator.fields import to_json
from greygate.emulator.program import Program
from greygate.errors import InputError
from greygate.hardware.synthesis import synthesize
from greygate.models.layer import LARGEST_SIZE
from greygate.models.network import Network, Port
from greygate.models.ports import ports
from greygate.models.storage import to_toml
from greygate.names import check_file_name, check_name, check_path, check_text, check_unit
from greygate.plants.recording import UNITS

INJECTED = '\n    initial $system("touch canary");\n//'
NOT_NAMES = [
    "", " ", "x y", " x", "x ", "x\n", "x\ty", "x\r\ny", INJECTED, "x\x00y", "x\x7f", "x\x1b[31m", "x\u0085y",
    "x\u2028y",
    "x\u202ey", "x\u2066y", "x\u200by", "x\u00a0y", "\ufeffx", "2nd", "-x", "x-y", "x/y", "/abs/path", "../up", "..",
    ".",
    ".x", "x.", "x..y", "a\\b", "C:\\x", "~x", "$x", "`x`", "x;y", "x'y", 'x"y', "x*/y", "/*x", "//x", "<b>x</b>",
    "</script>", "<!--x", "x&y", "x|y", "x(y)", "x[0]", "x{0}", "{{x}}", "%s", "x#y", "Öldruck", "µ", "дж", "ه", "x²",
    "x" * 101, "x" * 100_000,
]  # fmt: skip
NOT_UNITS = [
    "", " ", " m", "m ", "m\n", INJECTED, "m\x00", "m\x1b[1m", "m\x85", "m\u2028", "m\u202e", "m\u2066", "m\u200f",
    "m\u00a0s",
    "m\\", "m`", 'm"', "m;s", "<b>", "m>", "</script>", "m&s", "m#", "m$", "m|s", "m{", "m@", "m~", "m=s", "m?", "ه",
    "א",
    "m" * 41, "m" * 100_000,
]  # fmt: skip
NOT_TEXTS = [INJECTED, "a\tb", "a\x00", "a\x1b[0m", "a\u2028b", "a\u202eb", "", "a" * 501]
RESERVED = ["con", "NUL", "aux", "Com1", "lpt9"]


def one_line(error: InputError) -> bool:
    return str(error).isprintable() and len(str(error)) < 500


# -- where they enter


def saved_network(folder: Path, change) -> Path:
    """A legal network on disk but for what `change` does to its TOML."""
    network = delay_line()
    network.add("inner", Network("inner", [Port("i")], [Port("o")]))
    network.modules["inner"].connect("i", "o")
    network.connect("sum", "inner.i")
    network.meaning = "sign"
    network.save(folder / "line")
    data = to_toml(network)
    change(data)
    (folder / "line.toml").write_text(tomli_w.dumps(data), encoding="utf-8")
    return folder / "line.toml"


def in_network(change):
    def enter(folder, value):
        Network.load(saved_network(folder, lambda data: change(data, value)))

    return enter


def in_program(change):
    def enter(folder, value):
        data = json.loads(json.dumps(to_json(cylinder_program())))
        change(data, value)
        (folder / "program.json").write_text(json.dumps(data))
        Program.load(folder / "program.json")

    return enter


def renamed(entries: dict, old: str, new: str) -> None:
    entries[new] = entries.pop(old)


def from_csv(folder, value):
    """A quoted header holds any text; a column so named becomes a port."""
    with (folder / "a.csv").open("w", newline="", encoding="utf-8") as file:
        csv.writer(file).writerows([["t_s", value], [0, 1], [1, 2], [2, 1]])
    with (folder / "a.csv").open(newline="", encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    columns = np.array(rows, float).T
    ports(dict(zip(header, columns, strict=True)), {}, header[1:])


NAMES = {
    "a network": in_network(lambda d, v: d.update(name=v)),
    "an inner network": in_network(lambda d, v: d["modules"]["inner"].update(name=v)),
    "an input": in_network(lambda d, v: d["inputs"][0].update(name=v)),
    "an output": in_network(lambda d, v: d["outputs"][0].update(name=v)),
    "a module": in_network(lambda d, v: renamed(d["modules"], "sum", v)),
    "a layer's port": in_network(lambda d, v: renamed(d["modules"]["sum"]["ports"], "own", v)),
    "a source": in_network(lambda d, v: d["connections"][0].update({"from": v})),
    "a target": in_network(lambda d, v: d["connections"][0].update(to=v)),
    "a program": in_program(lambda d, v: d.update(name=v)),
    "a program's input": in_program(lambda d, v: d["inputs"][0].update(name=v)),
    "a program's output": in_program(lambda d, v: d["outputs"][0].update(name=v)),
    "a signal": in_program(lambda d, v: d["inputs"][0]["signal"].update(name=v)),
    "a result": in_program(lambda d, v: d["operations"][0]["out"].update(name=v)),
    "an argument": in_program(lambda d, v: d["operations"][0]["args"].__setitem__(0, v)),
    "a table": in_program(lambda d, v: d["tables"][0].update(name=v)),
    "a noted signal": in_program(lambda d, v: d["notes"].update({v: "why"})),
    "a column of a CSV": from_csv,
    "a network in Python": lambda folder, v: replace(delay_line(), name=v).check(),
    "a port in Python": lambda folder, v: replace(delay_line(), outputs=[Port(v)]).check(),
    "a program in Python": lambda folder, v: replace(cylinder_program(), name=v).check(),
}
FILES = ("a network", "an inner network", "a program", "a network in Python", "a program in Python")
UNITS_ENTER = {
    "an input's unit": in_network(lambda d, v: d["inputs"][0].update(unit=v)),
    "an output's unit": in_network(lambda d, v: d["outputs"][0].update(unit=v)),
    "a program's unit": in_program(lambda d, v: d["outputs"][0].update(unit=v)),
    "a recording's unit": lambda folder, v: ports({"x": np.arange(3.0)}, {"x": v}, ["x"]),
    "a unit in Python": lambda folder, v: replace(delay_line(), inputs=[Port("u", v)]).check(),
}
TEXTS = {
    "a meaning": in_network(lambda d, v: d.update(meaning=v)),
    "a note": in_program(lambda d, v: d["notes"].update(u=v)),
    "a table's function": in_program(lambda d, v: d["tables"][0].update(function=v)),
}


@pytest.mark.parametrize("entrance", NAMES)
def test_a_name_that_is_none_is_refused_in_one_line_where_it_enters(tmp_path, entrance):
    assert len(NOT_NAMES) >= 55
    for name in NOT_NAMES + (["a.b", *RESERVED] if entrance in FILES else []):
        with pytest.raises(InputError) as refused:
            NAMES[entrance](tmp_path, name)
        assert one_line(refused.value), name
        assert "rename it" in str(refused.value), name


@pytest.mark.parametrize("entrance", UNITS_ENTER)
def test_a_unit_that_is_none_is_refused_in_one_line_where_it_enters(tmp_path, entrance):
    assert len(NOT_UNITS) >= 30
    for unit in NOT_UNITS:
        with pytest.raises(InputError, match="a unit has letters") as refused:
            UNITS_ENTER[entrance](tmp_path, unit)
        assert one_line(refused.value), unit


@pytest.mark.parametrize("entrance", TEXTS)
def test_a_text_of_several_lines_or_hidden_characters_is_refused_where_it_enters(tmp_path, entrance):
    for text in NOT_TEXTS:
        with pytest.raises(InputError, match="a text is one line") as refused:
            TEXTS[entrance](tmp_path, text)
        assert one_line(refused.value), text


@pytest.mark.parametrize("wrong", [5, 1.5, True, None, [], {}, b"x"])
def test_what_is_no_string_is_neither_a_name_nor_a_unit(wrong):
    for check in (check_name, check_path, check_unit, check_text, check_file_name):
        with pytest.raises(InputError):
            check(wrong, "it")


def test_names_and_units_that_users_have_are_legal():
    for name in ("u", "_", "x_cmd", "P_A", "pa.divider.hidden1", "y.sub.tap0", "x2", "nul", "x" * 100):
        assert check_path(name, "port") == name
    for unit in {*UNITS.values(), "Ω", "°C", "%", "µm", "μm", "m²", "kg·m²", "N m", "m^(5/2)/kg^(1/2)", "1/min", "‰",
                 "s⁻¹",
                 "rad/(N m)^3", "m^3/(s sqrt Pa)", "Å", "½ m", "m·s-2"}:  # fmt: skip
        assert check_unit(unit, "port") == unit
    for text in ("2024-05-01 run 3 (kalt)", "<test>", "Öl, 40 °C", "v1"):
        assert check_text(text, "scenario") == text


def test_only_a_plain_component_of_a_path_names_a_file():
    for name in ("mine.toml", "p_table_tansig.v", "parallel", "v1.2-x"):
        assert check_file_name(name, "file") == name
    for name in ("", ".", "..", ".x", "x.", "a/b", "/a", "../a", "a\\b", "C:a", "a b", "a;b", "a\nb", "a\0", "ä", "con",
                 "CON.txt", "nul.v", "a" * 241):  # fmt: skip
        with pytest.raises(InputError) as refused:
            check_file_name(name, "file")
        assert one_line(refused.value)


def test_a_network_of_a_hostile_name_writes_nothing_outside_or_inside_the_folder(tmp_path):
    inside = tmp_path / "deep" / "inside"
    inside.mkdir(parents=True)
    record = recording(inside / "a.csv")
    for name in ("../up", str(tmp_path / "absolute"), "a/b"):
        network = saved_network(inside, lambda data, name=name: data.update(name=name))
        before = sorted(tmp_path.rglob("*"))
        for command in (("train", network, record), ("compile", network, f"train={record}")):
            code, out, error = greygate(*command, "--out", inside / "out")
            assert (code, out) == (2, "")
            assert error.strip().count("\n") == 0
            assert "rename it" in error
        assert sorted(tmp_path.rglob("*")) == before


def test_a_list_of_files_with_a_command_in_it_is_not_given_to_yosys(tmp_path):
    (tmp_path / "p.f").write_text("p.v\nx;!touch${IFS}canary;.v\n")
    with pytest.raises(InputError, match="no plain name of a file"):
        synthesize(tmp_path, "p")


# -- files are read strictly

WRONG = [
    None,
    True,
    "x",
    5,
    -1,
    0,
    1.5,
    10**12,
    10**40,
    1e308,
    float("nan"),
    float("inf"),
    [],
    [[]],
    [1, "x"],
    {},
    {"a": 1},
]


def places(data, path=()):
    """Every place in nested tables and the first two of each list, as the keys that lead there."""
    for key, value in data.items() if isinstance(data, dict) else enumerate(data[:2]):
        yield (*path, key)
        if isinstance(value, dict | list):
            yield from places(value, (*path, key))


def spoilt(data, path, value):
    """The data with another value at a place, or without it where the value is `places`."""
    data = copy.deepcopy(data)
    inside = data
    for key in path[:-1]:
        inside = inside[key]
    if value is places:
        del inside[path[-1]]
    else:
        inside[path[-1]] = value
    return data


def ends_well(load, *arguments) -> bool:
    """Whether a file is read; it is, or InputError says in one line why not."""
    try:
        load(*arguments)
    except InputError as error:
        said = error
    else:
        return True
    assert one_line(said)
    return False


def test_any_entry_of_a_networks_file_may_be_wrong_or_missing(tmp_path):
    path = saved_network(tmp_path, lambda data: None)
    data = to_toml(Network.load(path))
    refused = 0
    for place in places(data):
        for value in [places, *[v for v in WRONG if v is not None]]:
            path.write_text(tomli_w.dumps(spoilt(data, place, value)))
            refused += not ends_well(Network.load, path)
    assert refused > 800


def test_any_entry_of_a_programs_file_may_be_wrong_or_missing(tmp_path):
    data = json.loads(json.dumps(to_json(random_program(5))))
    path, refused = tmp_path / "program.json", 0
    for place in places(data):
        for value in [places, *WRONG]:
            path.write_text(json.dumps(spoilt(data, place, value)))
            refused += not ends_well(Program.load, path)
    assert refused > 1500


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"name": "a", "name": "b"}', "the entry 'name' appears twice"),
        ("[" * 100_000, "nested more than"),
        ("[]", "is not a table"),
        ("1" * 5000, "is not JSON"),
        ("\ud800", "is not JSON"),
    ],
)
def test_a_program_that_is_no_table_of_its_entries_is_named(tmp_path, text, message):
    (tmp_path / "p.json").write_bytes(text.encode("utf-8", "surrogatepass"))
    with pytest.raises(InputError, match=message) as refused:
        Program.load(tmp_path / "p.json")
    assert one_line(refused.value)


def test_unknown_entries_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"inputs\[0\]\.'unti': there is no such entry"):
        Network.load(saved_network(tmp_path, lambda data: data["inputs"][0].update(unti="m")))


@pytest.mark.parametrize(
    "change",
    [
        lambda t: t.pop("sum.bias"),
        lambda t: t.update({"sum.bias": np.zeros(2)}),
        lambda t: t.update({"sum.bias": np.array(["0.5"]).view(np.uint8)[:1]}),
        lambda t: t.update({"sum.bias": np.array([np.nan])}),
        lambda t: t.update({"sum.bias": np.array([1])}),
        lambda t: t.update({"sum.now": np.zeros((1, 0))}),
        lambda t: t.update({"else\nwhere": np.zeros(1)}),
    ],
)
def test_numbers_of_another_shape_or_kind_are_refused(tmp_path, change):
    path = saved_network(tmp_path, lambda data: None)
    tensors = load_file(path.with_suffix(".safetensors"))
    change(tensors)
    save_file(tensors, path.with_suffix(".safetensors"))
    with pytest.raises(InputError) as refused:
        Network.load(path)
    assert one_line(refused.value)


def test_a_network_inside_itself_or_nested_without_end_is_refused(tmp_path):
    itself = delay_line()
    itself.add("again", itself)
    with pytest.raises(InputError, match="at most 100 characters"):
        itself.check()
    head = f"[modules.{'a.modules.' * 300}a]\nname = 'a'\n"
    path = saved_network(tmp_path, lambda data: None)
    path.write_text(path.read_text().replace("[modules.sum]", head + "[modules.sum]", 1))
    with pytest.raises(InputError) as refused:
        Network.load(path)
    assert one_line(refused.value)


def test_two_parts_of_a_network_cannot_have_one_name():
    for change in (
        lambda n: n.inputs.append(Port("u")),
        lambda n: n.outputs.append(Port("u")),
        lambda n: n.modules.update(u=n.modules["sum"]),
    ):
        network = delay_line()
        change(network)
        with pytest.raises(InputError, match="used twice"):
            network.check()


def test_sizes_beyond_all_hardware_are_refused_at_once():
    for size in (0, -1, LARGEST_SIZE + 1, 10**12, 1.0, "1"):
        with pytest.raises(InputError, match="its size"):
            replace(delay_line(), outputs=[Port("y", size=size)]).check()
