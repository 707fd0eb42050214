// SPDX-License-Identifier: MIT
// Multiply-accumulate: acc = bias + sum of (word x << shift), exact. A shift is BASE and the stages that `select` names.
// Four clocks from x and word to acc; `select` comes one clock after them, `first` and `bias` three.

`default_nettype none

module greygate_mac #(
    parameter X_W = 16,      // width of a code, or of a part of it
    parameter WORD_W = 16,   // width of a word of a weight
    parameter ACC_W = 40,    // width of the sum; proved from the formats that no sum overflows it
    parameter BASE = 0,      // the least shift
    parameter STAGES = 1,    // stages of shifts beyond it
    parameter [STAGES*8-1:0] AMOUNTS = 0  // the shift of each stage, that of stage 0 lowest
) (
    input  wire                     clk,
    input  wire signed [   X_W-1:0] x,
    input  wire signed [WORD_W-1:0] word,
    input  wire        [STAGES-1:0] select,
    input  wire                     first,  // the product opens a sum: start at bias
    input  wire signed [ ACC_W-1:0] bias,
    output reg  signed [   X_W-1:0] x_reg,  // the code of the clock before, for the next multiplier
    output reg  signed [ ACC_W-1:0] acc
);

    localparam P = X_W + WORD_W;
    localparam W = P > ACC_W ? P : ACC_W;

    reg signed [WORD_W-1:0] word_reg;
    reg        [STAGES-1:0] select_reg;
    wire signed [    P-1:0] product_reg;
    reg signed [ ACC_W-1:0] shifted_reg;

    function automatic signed [W-1:0] shifted(input signed [P-1:0] product, input [STAGES-1:0] stages);
        integer k;
        begin
            shifted = {{W - P + 1{product[P-1]}}, product[P-2:0]} <<< BASE;
            for (k = 0; k < STAGES; k = k + 1) if (stages[k]) shifted = shifted <<< AMOUNTS[k*8+:8];
        end
    endfunction

    wire signed [W-1:0] wide = shifted(product_reg, select_reg);

    always @(posedge clk) begin
        x_reg <= x;
        word_reg <= word;
        select_reg <= select;
        shifted_reg <= wide[ACC_W-1:0];
        acc <= (first ? bias : acc) + shifted_reg;
    end

    generate
        if (BASE > 0 && AMOUNTS == 0) begin : always_shifted
            // kept: Yosys, which would pack this register and the next into an iCE40's DSP, loses the wires between them
            (* keep *) reg signed [P-1:0] product;
            always @(posedge clk) product <= x_reg * word_reg;
            assign product_reg = product;
        end else begin : shifted_by_mode
            reg signed [P-1:0] product;
            always @(posedge clk) product <= x_reg * word_reg;
            assign product_reg = product;
        end
        if (W > ACC_W) begin : wider
            wire unused = &{1'b0, wide[W-1:ACC_W]};  // copies of the sign
        end
        if (X_W < 2 || WORD_W < 2 || ACC_W < 2 || BASE < 0 || STAGES < 1) begin : check
            greygate_mac_parameters_are_illegal illegal ();
        end
    endgenerate

endmodule

`default_nettype wire
