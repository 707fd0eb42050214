"""Schemas are as they were promised, and refuse their own examples where a field is missing, is one too many, or has
another type."""

import json
import os
import re
from copy import deepcopy
from pathlib import Path

import pytest
from checking import FILES, TRAINED, lines, valid_files, validator

from greygate import schemas

ROOT = Path(__file__).parents[1]
CONTRACT = ROOT / "tests" / "contract.json"
WRITE = "GREYGATE_WRITE=1 python -m pytest tests/test_schemas.py -k promised"
TYPES = (None, True, 0.5, "text", [], {})  # a value of each type
FEWEST = 4  # of these that a field refuses: a number that may be null takes two of them
PLAIN = {"program"}  # without an example; tests/test_program_schema.py spoils programs
FREE = {  # fields that hold what each machine, proof or pruning has to tell
    "catalogue-training": {"seconds", "neurons"},
    "prove": {"rows", "figures"},
    "report": {"frf", "references"},
    "build": {"pruning"},
    "reveal": {"faulty"},
    "sealed-answer": {"faulty"},
}


def contract():
    """Every schema, and every part that several may share, without examples."""
    parts, found = {}, {}
    for name in schemas.names():
        schema = {**schemas.load(name)}
        for kind, part in schema.pop("$defs").items():
            assert parts.setdefault(kind, part) == part, f"two classes are called {kind}"
        found[name] = {key: value for key, value in schema.items() if key not in ("examples", "$schema")}
    return {"schemas": found, "parts": dict(sorted(parts.items()))}


def test_the_schemas_are_those_that_were_promised():
    """A field is added without a new version; one that goes, or means something else, makes one."""
    found = contract()
    if os.environ.get("GREYGATE_WRITE"):
        CONTRACT.write_text(lines(found), encoding="utf-8")
    promised = json.loads(CONTRACT.read_text(encoding="utf-8"))
    for of, entries in promised.items():
        for name in {*entries, *found[of]}:
            assert found[of].get(name) == entries.get(name), f"{of}: {name}; if that is meant: {WRITE}"


def objects(value, path=()):
    """(path, object) of every object in a value."""
    if isinstance(value, dict):
        yield path, value
    for key, inner in value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ():
        yield from objects(inner, (*path, key))


def changed(example, path, fields):
    """The example in which the object at the path has other fields; those that are ... are taken away."""
    found = deepcopy(example)
    inner = found
    for key in path:
        inner = inner[key]
    inner |= fields
    for key in [key for key, value in fields.items() if value is ...]:
        del inner[key]
    return found


def optional(schema):
    """The names of the fields that need not be there, anywhere in a schema."""
    for _, part in objects(schema):
        if isinstance(part.get("properties"), dict):
            yield from set(part["properties"]) - set(part.get("required", ()))


@pytest.mark.parametrize("name", schemas.names())
def test_a_missing_field_and_a_field_of_another_type_are_refused(name):
    schema, check, tried = schemas.load(name), validator(name), 0
    check.check_schema(schema)
    assert schema["$id"].startswith(f"urn:greygate:{name}:")
    for example in schema.get("examples", ()):
        check.validate(example)
        for path, owner in objects(example):
            if FREE.get(name, set()) & {*path}:
                continue
            named = owner and check.is_valid(changed(example, path, {"another": next(iter(owner.values()))}))
            for key in owner:
                tried += 1
                if not named and key not in {*optional(schema)}:
                    assert not check.is_valid(changed(example, path, {key: ...})), (*path, key)
                if key not in FREE.get(name, ()):
                    refused = [not check.is_valid(changed(example, path, {key: value})) for value in TYPES]
                    assert sum(refused) >= FEWEST, (*path, key)
    assert tried or name in PLAIN


def test_every_result_of_a_command_has_a_schema_and_every_schema_is_of_a_result_or_a_file():
    sources = "".join(path.read_text() for path in (ROOT / "greygate" / "cli").glob("*.py"))
    given = re.findall(r'\bgive\(\s*"([\w-]+)",', sources)
    assert len(given) == len(re.findall(r"\bgive\(", sources)) - 1  # the definition
    assert {*given, *FILES.values(), *TRAINED} == {*schemas.names()}


def test_the_files_of_a_build_follow_their_schemas(compiled):
    assert set(valid_files(compiled)) == {"compile.json", "manifest.json", "program.json"}


def test_schema_prints_one_or_lists_all(greygate):
    code, out, _ = greygate("dev", "schema", "verify")
    assert (code, json.loads(out)) == (0, schemas.load("verify"))
    code, out, _ = greygate("dev", "schema", "--json")
    assert (code, list(json.loads(out))) == (0, schemas.names())
    code, _, error = greygate("dev", "schema", "verified?")
    assert code == 2
    assert error.startswith("greygate: no schema 'verified?'; there are app, augment, ")


def test_the_page_names_every_schema_whose_results_do_not_say_it():
    (told,) = re.findall(r"^Without a `schema` entry: (.*?)\n\n", (ROOT / "docs" / "json.md").read_text(), re.M | re.S)
    silent = [name for name in schemas.names() if '"schema": {"const"' not in json.dumps(schemas.load(name))]
    assert re.findall(r"`([\w-]+)`", told) == silent


def test_a_figure_that_is_not_finite_is_null():
    printed = json.loads(
        schemas.text("simulate", {"out": "a.csv", "rms": {"x": {"rms": float("nan"), "unit": "m", "finite": False}}})
    )
    assert printed["schema"] == "greygate/simulate/1"
    assert printed["rms"]["x"]["rms"] is None
