// SPDX-License-Identifier: MIT
// Select: for each of SIZE elements, ABOVE where the condition is not negative, else BELOW, in the output format.
// docs/integer-program.md, "SELECT". One clock: y follows when en is high.

`default_nettype none

module greygate_select #(
    parameter SIZE = 1,        // number of codes side by side in each argument and in y
    parameter CONDITION_W = 16,
    parameter ABOVE_W = 16,    // widths of an argument
    parameter BELOW_W = 16,
    parameter OUT_W = 16,      // width of a result
    parameter ABOVE_LEFT = 0,  // zeros appended to bring a value to the finer fraction of the two
    parameter BELOW_LEFT = 0,
    parameter SHIFT = 0,       // fraction bits dropped after that; negative: zeros appended
    parameter ROUNDING = 1     // 0 truncate, 1 half up, 2 half even
) (
    input  wire                        clk,
    input  wire                        en,
    input  wire [SIZE*CONDITION_W-1:0] condition,
    input  wire [    SIZE*ABOVE_W-1:0] above,
    input  wire [    SIZE*BELOW_W-1:0] below,
    output wire [      SIZE*OUT_W-1:0] y
);

    localparam WIDER = ABOVE_W + ABOVE_LEFT > BELOW_W + BELOW_LEFT ? ABOVE_W + ABOVE_LEFT : BELOW_W + BELOW_LEFT;
    localparam W = (SHIFT > WIDER ? SHIFT : WIDER) + 1;  // the rounding constant fits as well

    wire unused = &{1'b0, condition};  // only its signs matter

    genvar n;
    generate
        for (n = 0; n < SIZE; n = n + 1) begin : element
            wire negative = condition[(n+1)*CONDITION_W-1];
            wire [ABOVE_W-1:0] a = above[n*ABOVE_W+:ABOVE_W];
            wire [BELOW_W-1:0] b = below[n*BELOW_W+:BELOW_W];
            wire signed [W-1:0] wide_a = {{W - ABOVE_W{a[ABOVE_W-1]}}, a};
            wire signed [W-1:0] wide_b = {{W - BELOW_W{b[BELOW_W-1]}}, b};
            greygate_requantize #(
                .IN_W(W),
                .OUT_W(OUT_W),
                .SHIFT(SHIFT),
                .ROUNDING(ROUNDING),
                .SATURATE(1)
            ) requantize (
                .clk(clk),
                .en(en),
                .a(negative ? wide_b <<< BELOW_LEFT : wide_a <<< ABOVE_LEFT),
                .y(y[n*OUT_W+:OUT_W])
            );
        end
        if (SIZE < 1 || CONDITION_W < 2 || ABOVE_W < 2 || BELOW_W < 2 || ABOVE_LEFT < 0 || BELOW_LEFT < 0) begin : check
            greygate_select_parameters_are_illegal illegal ();
        end
    endgenerate

endmodule

`default_nettype wire
