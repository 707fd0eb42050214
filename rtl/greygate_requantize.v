// SPDX-License-Identifier: MIT
// Requantize: bring an exact accumulator to an output format, rounding once.
// docs/integer-program.md, "Numbers". One clock: y follows a when en is high.

`default_nettype none

module greygate_requantize #(
    parameter IN_W = 32,     // width of the accumulator; the rounding constant must not overflow it
    parameter OUT_W = 16,    // width of the result
    parameter SHIFT = 8,     // fraction bits dropped; negative: zeros appended
    parameter ROUNDING = 1,  // 0 truncate, 1 half up, 2 half even
    parameter SATURATE = 1   // 1 saturate, 0 wrap
) (
    input  wire                    clk,
    input  wire                    en,
    input  wire signed [ IN_W-1:0] a,
    output reg  signed [OUT_W-1:0] y
);

    localparam RIGHT = SHIFT > 0 ? SHIFT : 0;
    localparam LEFT = SHIFT < 0 ? -SHIFT : 0;
    localparam W = (IN_W + LEFT > OUT_W ? IN_W + LEFT : OUT_W) + 1;  // holds every value below

    localparam signed [W-1:0] ONE = {{W - 1{1'b0}}, 1'b1};
    localparam signed [W-1:0] HALF = RIGHT > 0 ? ONE <<< (RIGHT > 0 ? RIGHT - 1 : 0) : {W{1'b0}};
    localparam signed [W-1:0] HI = (ONE <<< (OUT_W - 1)) - ONE;
    localparam signed [W-1:0] LO = -HI - ONE;

    function automatic [OUT_W-1:0] requantize(input signed [IN_W-1:0] code);
        reg signed [W-1:0] v;
        begin
            v = {{W - IN_W{code[IN_W-1]}}, code};
            if (ROUNDING == 1) v = v + HALF;
            if (ROUNDING == 2 && RIGHT > 0) v = v + HALF - ONE + ((v >>> RIGHT) & ONE);
            v = (v >>> RIGHT) <<< LEFT;
            if (SATURATE == 1 && v > HI) v = HI;
            if (SATURATE == 1 && v < LO) v = LO;
            requantize = v[OUT_W-1:0];
        end
    endfunction

    always @(posedge clk) if (en) y <= requantize(a);

    generate
        if (OUT_W < 2 || IN_W < 2 || RIGHT > IN_W || ROUNDING < 0 || ROUNDING > 2 || SATURATE < 0 || SATURATE > 1) begin : check
            greygate_requantize_parameters_are_illegal illegal ();
        end
    endgenerate

endmodule

`default_nettype wire
