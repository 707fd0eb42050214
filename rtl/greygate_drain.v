// SPDX-License-Identifier: MIT
// Drain: bring a sum, to which the rounding constant has been added, to one of few formats.
// docs/integer-program.md, "Numbers". One clock from a and mode to y.
// A tie that goes to even is seen by the bits that are dropped: with the constant added they are all 0.

`default_nettype none

module greygate_drain #(
    parameter IN_W = 40,   // width of the sum
    parameter OUT_W = 16,  // width of the widest format
    parameter MODES = 1,   // ways to drain
    parameter MODE_W = 1,  // width of `mode`
    parameter [MODES*8-1:0] SHIFTS = 0,        // bits dropped in each mode, that of mode 0 lowest
    parameter [MODES*8-1:0] WIDTHS = {MODES{8'd16}},  // width of the format
    parameter [MODES-1:0] EVEN = 0,            // 1: a tie goes to even
    parameter [MODES-1:0] WRAPS = 0            // 1: the low bits are kept, 0: the result saturates
) (
    input  wire                     clk,
    input  wire signed [  IN_W-1:0] a,
    input  wire        [MODE_W-1:0] mode,
    output reg  signed [ OUT_W-1:0] y
);

    localparam W = IN_W > OUT_W ? IN_W : OUT_W;
    localparam [W-1:0] ONES = {W{1'b1}};

    function automatic [OUT_W-1:0] drained(input signed [IN_W-1:0] sum, input [MODE_W-1:0] how);
        integer k;
        reg signed [W-1:0] v, q;
        reg [W-1:0] above;  // the bits that hold only copies of the sign
        reg tie, wraps, fits, sign;
        begin
            v = {{W - IN_W + 1{sum[IN_W-1]}}, sum[IN_W-2:0]};
            q = v >>> SHIFTS[0+:8];
            above = ONES << (WIDTHS[0+:8] - 8'd1);
            tie = EVEN[0] && (v & ~(ONES << SHIFTS[0+:8])) == {W{1'b0}};
            wraps = WRAPS[0];
            for (k = 1; k < MODES; k = k + 1)
                if (how == k[MODE_W-1:0]) begin
                    q = v >>> SHIFTS[k*8+:8];
                    above = ONES << (WIDTHS[k*8+:8] - 8'd1);
                    tie = EVEN[k] && (v & ~(ONES << SHIFTS[k*8+:8])) == {W{1'b0}};
                    wraps = WRAPS[k];
                end
            if (tie) q[0] = 1'b0;
            fits = (q & above) == {W{1'b0}} || (~q & above) == {W{1'b0}};
            sign = wraps ? |(q & above & ~(above << 1)) : q[W-1];
            if (!fits && !wraps) q = {W{~sign}};
            q = sign ? q | above : q & ~above;
            drained = q[OUT_W-1:0];
        end
    endfunction

    always @(posedge clk) y <= drained(a, mode);

    generate
        if (IN_W < 2 || OUT_W < 2 || MODES < 1 || MODE_W < 1) begin : check
            greygate_drain_parameters_are_illegal illegal ();
        end
    endgenerate

endmodule

`default_nettype wire
