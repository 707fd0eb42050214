// SPDX-License-Identifier: MIT
// Product: a number times an unsigned one, by adders instead of a multiplier; combinational.
// A row of every bit of the factor is added to the rows before it, of which one bit a row is done. Two such chains, of
// the lower and of the upper half of the factor, stand side by side, so that half as many additions follow each other.

`default_nettype none

module greygate_product #(
    parameter A_W = 9,    // width of a
    parameter SIGNED = 0, // 1: a has a sign
    parameter B_W = 8     // width of b
) (
    input  wire [    A_W-1:0] a,
    input  wire [    B_W-1:0] b,
    output wire [A_W+B_W-1:0] y
);

    localparam LOWER = B_W > 3 ? B_W / 2 : B_W;  // bits of the lower half
    localparam UPPER = B_W - LOWER;
    localparam W = A_W + 1;

    wire sign = SIGNED == 1 && a[A_W-1];
    wire [W*B_W-1:0] sums;  // of the rows so far, less the bits that are done

    genvar k;
    generate
        for (k = 0; k < B_W; k = k + 1) begin : row
            wire [W-1:0] addend = {sign, a} & {W{b[k]}};
            if (k == 0 || k == LOWER) begin : first
                assign sums[W*k+:W] = addend;
            end else begin : next
                // kept apart: a tool that merges the additions of a product needs more logic
                (* keep *) wire [W-1:0] sum;
                assign sum = {SIGNED == 1 && sums[W*k-1], sums[W*k-1-:W-1]} + addend;
                assign sums[W*k+:W] = sum;
            end
        end

        wire [A_W+LOWER-1:0] lower;
        for (k = 0; k + 1 < LOWER; k = k + 1) begin : lower_bit
            assign lower[k] = sums[W*k];
        end
        assign lower[A_W+LOWER-1:LOWER-1] = sums[W*(LOWER-1)+:W];

        if (UPPER > 0) begin : halves
            wire [A_W+UPPER-1:0] upper;
            for (k = 0; k + 1 < UPPER; k = k + 1) begin : upper_bit
                assign upper[k] = sums[W*(LOWER+k)];
            end
            assign upper[A_W+UPPER-1:UPPER-1] = sums[W*(B_W-1)+:W];
            (* keep *) wire [A_W+UPPER-1:0] sum;
            assign sum = upper + {{UPPER{SIGNED == 1 && lower[A_W+LOWER-1]}}, lower[A_W+LOWER-1:LOWER]};
            assign y = {sum, lower[LOWER-1:0]};
        end else begin : whole
            assign y = lower;
        end

        if (A_W < 1 || B_W < 1) begin : check
            greygate_product_parameters_are_illegal illegal ();
        end
    endgenerate

endmodule

`default_nettype wire
