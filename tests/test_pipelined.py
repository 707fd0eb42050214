"""The pipelined architecture: samples under way at once, with gaps and pauses, and channels that take turns."""

import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from legal_programs import legal_codes, legal_program
from programs import random_codes, random_program
from test_rtl import lint, ring

from greygate.compiler.emit import emit
from greygate.compiler.targets import Design
from greygate.emulator.interpreter import interpret
from greygate.hardware.verify import Case, Scenario, lanes, verify_many, width

STEPS = 40
BENCH = """
module tb;
    reg clk = 0, rst = 1, valid = 0, ready = 0, full = 0;
    always #1 clk = ~clk;
    reg [{win}:0] given [0:{last}];
    reg [{wout}:0] wanted [0:{last}];
    integer i = 0, o = 0, bad = 0, clocks = 0, seed = 7;
    wire taken, shown;
    wire [{wout}:0] answer;
    {name} core (
        .clk(clk), .rst(rst), .s_axis_tdata(given[i]), .s_axis_tvalid(valid && i <= {last}), .s_axis_tready(taken),
        .m_axis_tdata(answer), .m_axis_tvalid(shown), .m_axis_tready(ready)
    );
    initial begin
        $readmemh("given.hex", given);
        $readmemh("wanted.hex", wanted);
        full = $test$plusargs("full");
        #7 rst = 0;
    end
    always @(posedge clk) if (!rst) begin
        clocks <= clocks + 1;
        if (taken && valid && i <= {last}) i <= i + 1;
        if (taken || !valid) valid <= full || $random(seed) % 3 != 0;  // an offer stays until it is taken
        if (shown && ready) begin
            if (answer !== wanted[o]) bad <= bad + 1;
            o <= o + 1;
        end
        if (o > {last} || clocks > 999999) begin
            $display("steps %0d bad %0d clocks %0d", o, bad, clocks);
            $finish;
        end
    end
    always @(negedge clk) ready <= full || $random(seed) % 3 != 0;
endmodule
"""


def streamed(p, codes, folder, design, architecture="pipelined"):
    """Clocks of a run without and with pauses, in which every result is what the channel's own run gives."""
    inputs, outputs = [t.signal for t in p.inputs], [t.signal for t in p.outputs]
    wanted = np.zeros((len(codes), sum(s.size for s in outputs)), np.int64)
    for c in range(design.channels):
        wanted[c :: design.channels] = interpret(p, codes[c :: design.channels]).outputs
    files = emit(p, folder, architecture, design)
    for name, rows in (("given", lanes(inputs, codes)), ("wanted", lanes(outputs, wanted))):
        (folder / f"{name}.hex").write_text("".join(row[::-1].tobytes().hex() + "\n" for row in rows))
    sizes = {"win": width(inputs) - 1, "wout": width(outputs) - 1, "last": len(codes) - 1, "name": p.name}
    (folder / "tb.v").write_text(BENCH.format(**sizes))
    sources = [f.name for f in files if f.suffix == ".v"]
    subprocess.run(["iverilog", "-g2005", "-o", "tb", "tb.v", *sources], cwd=folder, check=True, capture_output=True)
    found = []
    for options in (["+full"], []):
        said = subprocess.run(["vvp", "-n", "tb", *options], cwd=folder, capture_output=True, text=True).stdout
        steps, bad, clocks = map(int, re.search(r"steps (\d+) bad (\d+) clocks (\d+)", said).groups())
        assert (steps, bad) == (len(codes), 0), said
        found.append(clocks)
    return found


@pytest.mark.skipif(shutil.which("iverilog") is None, reason="needs Icarus Verilog")
@pytest.mark.parametrize("channels", [1, 3, 4])
def test_every_channel_equals_its_own_run_whatever_pauses(tmp_path, channels):
    for seed in range(4):
        design = Design(adders=seed, channels=channels)
        p = replace(random_program(seed), name=f"random{seed}")
        streamed(p, random_codes(p, seed, STEPS), tmp_path / p.name, design)
        p = legal_program(seed, f"legal{seed}")
        streamed(p, legal_codes(p, seed, STEPS), tmp_path / p.name, design)


@pytest.mark.skipif(shutil.which("iverilog") is None, reason="needs Icarus Verilog")
def test_a_program_without_feedback_and_enough_channels_take_a_sample_with_every_clock(tmp_path):
    p = ring("ring")  # three states that hand their values round
    slow, _ = streamed(p, random_codes(p, 1, STEPS), tmp_path / "one", Design())
    p = replace(random_program(1), name="random1")  # no feedback
    clocks, _ = streamed(p, random_codes(p, 1, STEPS), tmp_path / "two", Design())
    assert clocks < STEPS + 15
    p = replace(random_program(8), name="random8")  # a loop of four clocks
    alone, _ = streamed(p, random_codes(p, 1, STEPS), tmp_path / "three", Design(adders=2))
    several, _ = streamed(p, random_codes(p, 1, STEPS), tmp_path / "four", Design(adders=2, channels=4))
    assert several < STEPS + 15 < 3 * STEPS < alone
    assert slow < STEPS + 15


def test_the_bench_finds_no_difference_and_lint_nothing_to_say(tmp_path):
    cases = []
    for seed in range(6):
        p = replace(random_program(seed), name=f"random{seed}")
        codes = random_codes(p, seed, STEPS)
        run = interpret(p, codes)
        cases.append(
            Case(p, {"random": Scenario(codes, run.outputs, run.states)}, "pipelined", Design(adders=seed % 3))
        )
        emit(p, tmp_path / "lint" / p.name, "pipelined", Design(adders=1, channels=1 + seed % 3))
        assert lint(tmp_path / "lint" / p.name, p.name, "-f", f"{p.name}.f") == ""
    result = verify_many(cases, tmp_path / "bench", seed=3)
    assert [v.mismatch for v in result.verdicts if v.mismatch] == []
