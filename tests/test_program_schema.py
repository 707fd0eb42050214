"""The schema of program.json accepts what `Program.load` accepts, and says what is wrong with the rest."""

import json
from copy import deepcopy

import pytest
from legal_programs import legal_program
from programs import cylinder_program

from greygate.emulator.program import Program
from greygate.emulator.tables import Lines
from greygate.errors import InputError
from greygate.schemas import load

jsonschema = pytest.importorskip("jsonschema")

SCHEMA = load("program")
SEEDS = range(60)


@pytest.fixture(scope="module")
def check():
    kind = jsonschema.Draft202012Validator
    kind.check_schema(SCHEMA)
    return kind(SCHEMA).is_valid


@pytest.fixture(scope="module")
def plain(tmp_path_factory):
    """Programs as they stand in their files."""
    path = tmp_path_factory.mktemp("programs") / "program.json"

    def written(program: Program) -> dict:
        program.save(path)
        return json.loads(path.read_text(encoding="utf-8"))

    return written


def test_the_schema_accepts_every_program_that_is_saved(check, plain):
    programs = [cylinder_program(), *map(legal_program, SEEDS)]
    assert {type(o).__name__ for p in programs for o in p.operations} >= {"Affine", "Lookup", "Clamp", "Threshold"}
    assert any(isinstance(t, Lines) for p in programs for t in p.tables)
    assert [p.name for p in programs if not check(plain(p))] == []


SPOILT = {
    "no tables": lambda p: p.pop("tables"),
    "an entry too many": lambda p: p.update(extra=1),
    "a name with a space": lambda p: p.update(name="a b"),
    "a format of three numbers": lambda p: p["inputs"][0]["signal"]["fix"].append(0),
    "a width of 49": lambda p: p["inputs"][0]["signal"].update(fix=[49, 0]),
    "an empty signal": lambda p: p["inputs"][0]["signal"].update(size=0),
    "an unknown operation": lambda p: p["operations"][0].update(op="divide"),
    "a weight that is no integer": lambda p: p["operations"][0]["weights"][0].__setitem__(0, 0.5),
    "an unknown rounding": lambda p: p["operations"][0].update(rounding="up"),
    "a table of one point": lambda p: p["tables"][0].update(points=[0]),
    "a table of points and lines": lambda p: p["tables"][0].update(bases=[0], slopes=[0]),
    "no period": lambda p: p.update(period=0),
    "a note that is no text": lambda p: p.update(notes={"u": 1}),
}


@pytest.mark.parametrize("change", SPOILT)
def test_the_schema_refuses_what_loading_refuses(change, check, plain, tmp_path):
    program = plain(cylinder_program())
    assert check(program)
    spoilt = deepcopy(program)
    SPOILT[change](spoilt)
    assert not check(spoilt)
    (tmp_path / "p.json").write_text(json.dumps(spoilt), encoding="utf-8")
    with pytest.raises(InputError):
        Program.load(tmp_path / "p.json")
