"""`greygate verify` leaves a waveform of the first step that differs."""

import json
import re

import pytest

from greygate.compiler.quantize import Formats
from greygate.machines.source import Source
from greygate.project import compile_project

STEP = 7
SEED = 4  # with it the register that begins the waveform would power up as 1
COUNTED = "    reg [31:0] count;\n    always @(posedge clk) count <= rst ? 0 : count + done;\n"


@pytest.fixture
def spoilt(compiled, tmp_path):
    """A build in which one bit of the answer is wrong in one step, and right in every other."""
    source = Source(str(compiled.parent / "line.toml"), {"a": str(compiled.parent / "a.csv")})
    compile_project(source, tmp_path / "b", Formats(), architectures=("parallel",))
    core = tmp_path / "b" / "rtl" / "parallel" / "line.v"
    text = core.read_text()
    wrong = text.replace("        sum[15:0]\n", f"        sum[15:0] ^ (count == {STEP})\n")
    assert wrong != text
    core.write_text(wrong.replace("    // outputs\n", f"{COUNTED}    // outputs\n"))
    return tmp_path / "b"


def changes(path):
    """The steps of a VCD file: after each time, the value of every signal by its path."""
    scope, names, now, found = [], {}, {}, []
    for line in path.read_text().splitlines():
        words = line.split()
        if line.lstrip().startswith("$scope"):
            scope.append(words[2])
        elif line.lstrip().startswith("$upscope"):
            scope.pop()
        elif line.lstrip().startswith("$var"):
            names.setdefault(words[3], []).append(".".join([*scope, words[4]]))
        elif line.startswith("#"):
            found.append(dict(now))
        elif line.startswith("b"):
            now |= dict.fromkeys(names[words[1]], int(words[0][1:], 2))
        elif line[:1] in ("0", "1"):
            now |= dict.fromkeys(names[line[1:]], int(line[0]))
    return [*found, now]


@pytest.mark.nightly
def test_the_waveform_holds_the_named_signal_in_the_step_that_differs(spoilt, greygate):
    code, out, error = greygate("verify", spoilt, "--seed", SEED, "--as-is", "--json")
    found = json.loads(out)
    said = re.fullmatch(
        rf"step {STEP}: output y is (-?\d+), the emulator has (-?\d+)", found["verdicts"][0]["mismatch"]
    )
    assert (code, bool(said)) == (1, True)
    assert "line.v is not the Verilog of program.json; verified as it is" in error
    waveform = spoilt / "simulation" / "parallel" / "dump.vcd"
    assert found["waveforms"] == {"parallel": str(waveform)}
    times = changes(waveform)
    (at,) = {path.partition("compared_0.")[0] for path in times[-1] if "compared_0.step" in path}
    during = [now for now in times if now.get(f"{at}compared_0.step") == STEP and now[f"{at}m_tvalid_0"]]
    seen = {(now[f"{at}compared_0.hardware.output_y"], now[f"{at}compared_0.emulator.output_y"]) for now in during}
    assert tuple(int(code) % 2**16 for code in said.groups()) in seen
    assert {now.get(f"{at}compared_0.step") for now in times} >= {STEP - 1, STEP}
    assert f"{at}design_0.sum_layer.sum" in times[-1]
