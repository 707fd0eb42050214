// SPDX-License-Identifier: MIT
// Multiply: for each of SIZE elements, one code times the other, in the output format.
// docs/integer-program.md, "PRODUCT". Two clocks: the exact product follows when en is high, y when take is high.

`default_nettype none

module greygate_multiply #(
    parameter SIZE = 1,        // number of codes side by side in each argument and in y
    parameter ONE_W = 16,      // widths of an argument
    parameter OTHER_W = 16,
    parameter OUT_W = 16,      // width of a result
    parameter SHIFT = 15,      // fraction bits dropped; negative: zeros appended
    parameter ROUNDING = 1,    // 0 truncate, 1 half up, 2 half even
    parameter MULTIPLIERS = 1  // elements that are multiplied by a multiplier, which may be a DSP; the others by adders
) (
    input  wire                    clk,
    input  wire                    en,
    input  wire                    take,
    input  wire [  SIZE*ONE_W-1:0] one,
    input  wire [SIZE*OTHER_W-1:0] other,
    output wire [  SIZE*OUT_W-1:0] y
);

    localparam P = ONE_W + OTHER_W;
    localparam W = (SHIFT > P ? SHIFT : P) + 1;  // the rounding constant fits as well

    genvar n;
    generate
        for (n = 0; n < SIZE; n = n + 1) begin : element
            wire signed [  ONE_W-1:0] a = one[n*ONE_W+:ONE_W];
            wire signed [OTHER_W-1:0] b = other[n*OTHER_W+:OTHER_W];
            reg signed [P-1:0] product;
            if (n < MULTIPLIERS) begin : multiplied
                always @(posedge clk) if (en) product <= a * b;
            end else begin : added  // the sign of b counts minus 2^(OTHER_W - 1)
                wire [P-2:0] below;
                greygate_product #(
                    .A_W(ONE_W),
                    .SIGNED(1),
                    .B_W(OTHER_W - 1)
                ) rows (
                    .a(a),
                    .b(b[OTHER_W-2:0]),
                    .y(below)
                );
                wire [P-1:0] weight = {a[ONE_W-1], a, {OTHER_W - 1{1'b0}}};
                always @(posedge clk) if (en) product <= {below[P-2], below} - (weight & {P{b[OTHER_W-1]}});
            end
            greygate_requantize #(
                .IN_W(W),
                .OUT_W(OUT_W),
                .SHIFT(SHIFT),
                .ROUNDING(ROUNDING),
                .SATURATE(1)
            ) requantize (
                .clk(clk),
                .en(take),
                .a({{W - P{product[P-1]}}, product}),
                .y(y[n*OUT_W+:OUT_W])
            );
        end
        if (SIZE < 1 || ONE_W < 2 || OTHER_W < 2 || MULTIPLIERS < 0) begin : check
            greygate_multiply_parameters_are_illegal illegal ();
        end
    endgenerate

endmodule

`default_nettype wire
