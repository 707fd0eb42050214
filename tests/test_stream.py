"""docs/integer-program.md, "At the edges": what a reset does to samples and results, and what the core ignores."""

from functools import cache

import numpy as np
import pytest

from greygate.compiler.emit import emit, sources
from greygate.emulator.numbers import Fix
from greygate.emulator.program import Affine, Program, Signal, State, Terminal
from greygate.hardware.replay import simulate

FIX = Fix(9, 0)  # in a lane of 16 bits
INITIAL = 20
SILENT = 400  # clocks in which a dropped sample gives no result; a step of the slowest architecture takes fewer
ARCHITECTURES = ("parallel", "folded", "serial")


def total() -> Program:
    """y = y one step before + u, from 20."""
    u, held, y = (Signal(n, 1, FIX) for n in ("u", "held", "y"))
    weights, zero = np.array([[1, 1]]), np.array([0])
    return Program(
        "total",
        (Terminal("u", u, "1", 1.0, 0.0),),
        (State(held, "y", (INITIAL,)),),
        (Affine(y, ("u", "held"), weights, zero, zero),),
        (Terminal("y", y, "1", 1.0, 0.0),),
    ).check()


# Each case acts at one rising edge of the clock, or stays until what it waits for is there.
BENCH = f"""\
module bench (input clk);
    reg rst = 1, s_valid = 0, m_ready = 0;
    reg [15:0] s_data = 0;
    wire s_ready, m_valid;
    wire [15:0] m_data;
    total core (.clk(clk), .rst(rst), .s_axis_tdata(s_data), .s_axis_tvalid(s_valid), .s_axis_tready(s_ready),
        .m_axis_tdata(m_data), .m_axis_tvalid(m_valid), .m_axis_tready(m_ready));

    integer at = 0, idle = 0, file, untaken, ready_in_reset, valid_after, anew, taken, valid_after_both, more, dropped;
    integer seen = 0, last;
    always @(posedge clk) begin
        at <= at + 1;
        case (at)
            0: begin rst <= 0; s_valid <= 1; s_data <= 16'hfe05; end  // 5, and ones above the code
            1: if (s_ready) s_valid <= 0; else at <= 1;
            2: if (m_valid) begin
                untaken = $signed(m_data);
                {{rst, s_valid, s_data}} <= {{2'b11, 16'h5403}};  // 3 is offered
            end else at <= 2;
            3: begin ready_in_reset = s_ready; rst <= 0; end  // the reset acts at this edge, and a result waits
            4: begin valid_after = m_valid; if (s_ready) s_valid <= 0; end
            5: if (s_valid && !s_ready) at <= 5; else s_valid <= 0;
            6: if (m_valid) begin anew = $signed(m_data); rst <= 1; m_ready <= 1; end else at <= 6;
            7: begin taken = m_valid && m_ready ? $signed(m_data) : 0; rst <= 0; m_ready <= 0; end  // both at this edge
            8: begin valid_after_both = m_valid; s_valid <= 1; s_data <= 16'h0a04; end
            9: if (s_ready) s_valid <= 0; else at <= 9;
            10: if (m_valid) begin more = $signed(m_data); m_ready <= 1; end else at <= 10;
            11: begin m_ready <= 0; s_valid <= 1; s_data <= 16'h0007; end
            12: if (s_ready) s_valid <= 0; else at <= 12;
            13: rst <= 1;  // a sample is under way
            14: rst <= 0;
            15: begin seen = seen + m_valid; idle <= idle + 1; if (idle < {SILENT}) at <= 15; end
            16: begin dropped = seen; s_valid <= 1; s_data <= 16'h0001; end
            17: if (s_ready) s_valid <= 0; else at <= 17;
            18: if (m_valid) begin
                last = $signed(m_data);
                file = $fopen("result.json", "w");
                $fwrite(file, "[%0d, %0d, %0d, ", untaken, ready_in_reset, valid_after);
                $fwrite(file, "%0d, %0d, %0d, ", anew, taken, valid_after_both);
                $fwrite(file, "%0d, %0d, %0d]", more, dropped, last);
                $fclose(file);
                $finish;
            end else at <= 18;
        endcase
    end
endmodule
"""
SEEN = (
    ("a result with the bits above a code ignored", INITIAL + 5),
    ("s_axis_tready in a reset", 0),
    ("m_axis_tvalid after a reset, of a result that was not taken", 0),
    ("a sample offered through the reset, from the initial state", INITIAL + 3),
    ("a result taken at the edge of the reset", INITIAL + 3),
    ("m_axis_tvalid after that edge", 0),
    ("the next result, from the initial state", INITIAL + 4),
    ("clocks with a result of a sample that was under way", 0),
    ("the result after it, from the initial state", INITIAL + 1),
)


@cache
def answers(architecture: str, folder) -> dict[str, int]:
    emit(total(), folder, architecture)
    found = simulate(sources(folder, "total"), BENCH, {})
    return dict(zip((what for what, _ in SEEN), found, strict=True))


@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_a_reset_does_to_samples_and_results_what_the_text_says(architecture, tmp_path):
    assert answers(architecture, tmp_path) == dict(SEEN)
