"""Targets and FPGA families are known by one file or one row: whoever offers or reads a choice asks the registry."""

import json
import re

import pytest
from legal_programs import legal_program
from networks import delay_line
from programs import cylinder_program, random_program

from greygate.cli import words
from greygate.compiler import targets
from greygate.compiler.emit import emit, emitted
from greygate.compiler.targets import BOTH, NAMES, Architecture, Design, Target, target
from greygate.errors import InputError
from greygate.hardware.families import FAMILIES, TARGETS
from greygate.hardware.synthesis import counted, synthesize


@pytest.fixture
def stub(tmp_path, monkeypatch):
    """A target of one file, in a folder that is joined to that of the targets."""
    text = "from greygate.compiler.targets import Target\nTARGET = Target(lambda program, _: {'it.txt': program.name})"
    (tmp_path / "stub.py").write_text(text + "\n")
    monkeypatch.setattr(targets, "__path__", [*targets.__path__, str(tmp_path)])
    monkeypatch.setattr(targets, "NAMES", targets.named())


def test_a_target_is_one_file_in_the_folder(stub, tmp_path):
    assert (*NAMES[:2], *sorted(("stub", *NAMES[2:]))) == targets.NAMES
    (file,) = emit(cylinder_program(), tmp_path / "out", "stub")
    assert (file.name, file.read_text()) == ("it.txt", "cylinder")


@pytest.mark.parametrize("name", NAMES)
def test_every_target_writes_every_program(name):
    assert isinstance(target(name), Target)
    for program in (cylinder_program(), *map(random_program, range(6)), *map(legal_program, range(6))):
        texts = emitted(program, name, Design(multipliers=3))
        assert all(text.isprintable() or "\n" in text for text in texts.values())
        assert (f"{program.name}.f" in texts) == isinstance(target(name), Architecture)


@pytest.mark.parametrize("name", [*BOTH, "serial"])
def test_an_architecture_has_a_register_for_each_code_of_the_states(name):
    for program in (cylinder_program(), random_program(3)):
        registers = target(name).registers(program, Design())
        assert len(set(registers)) == len(registers) == sum(s.signal.size for s in program.states)


def test_the_command_line_offers_what_the_registries_hold():
    assert [*words.Architecture] == [*NAMES, "both"]
    assert [*words.Target] == [*TARGETS]


def test_a_listing_has_a_line_for_every_row_and_names_every_signal():
    program = random_program(3)
    (text,) = emitted(program, "listing").values()
    for signal in program.signals.values():
        assert f"{signal.name}[{signal.size}] {signal.fix}" in text
    assert len(re.findall(r"^    \[\d+\] = ", text, re.M)) == sum(
        o.out.size for o in program.operations if o.op == "affine"
    )


def test_a_build_without_verilog_is_neither_verified_nor_synthesized(greygate, tmp_path):
    rows = "".join(f"{k * 1e-3:.3f},{k % 5},{k % 5}\n" for k in range(50))
    (tmp_path / "u.csv").write_text("t_s,u_V,y_m\n" + rows)
    delay_line().save(tmp_path / "line")
    command = ["compile", tmp_path / "line.toml", f"u={tmp_path / 'u.csv'}", "--out", tmp_path / "build"]
    code, _, error = greygate(*command, "--architecture", "listing")
    assert code == 0, error
    assert json.loads((tmp_path / "build" / "compile.json").read_text())["architectures"] == ["listing"]
    for word in ("verify", "synthesize"):
        code, _, error = greygate(word, tmp_path / "build")
        assert (code, len(error.splitlines())) == (2, 1)
        assert "holds no Verilog; run greygate compile --architecture both" in error


def test_cells_are_counted_as_the_row_of_the_family_says():
    cells = {"LUT4": 10, "CCU2C": 3, "TRELLIS_FF": 7, "SB_DFFE": 2, "SB_DFFSR": 1, "RAMB18E1": 3, "FDRE": 1}
    assert counted(FAMILIES["ecp5"], cells) == {
        "luts": 16, "flip_flops": 7, "dsps": 0, "block_rams": 0, "lut_rams": 0
    }  # fmt: skip
    assert counted(FAMILIES["ice40"], cells)["flip_flops"] == 3
    assert counted(FAMILIES["xilinx"], cells)["block_rams"] == 1.5


def test_a_family_that_is_not_known_and_a_clock_rate_that_is_not_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"target 'apex' does not exist; choose ecp5, ice40, .* or xc7a100t"):
        synthesize(tmp_path, "top", "apex")
    with pytest.raises(InputError, match=r"the clock rate is known for target ecp5, ice40, up5k, .* only"):
        synthesize(tmp_path, "top", "gowin", clock_rate=True)
