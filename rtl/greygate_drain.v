// Drain: requantize with a shift, a rounding and an output width that are chosen from clock to clock.
// docs/integer-program.md, "Numbers". First clock: round and shift; then, combinational: saturate or wrap.

`default_nettype none

module greygate_drain #(
    parameter IN_W = 40,    // width of the accumulator; the rounding constant must not overflow it
    parameter OUT_W = 16,   // width of the widest output format
    parameter SHIFT_W = 6,  // width of the shift
    parameter LEFT = 0,     // the largest shift to the left
    parameter WIDTH_W = 6   // width of `width`
) (
    input  wire                      clk,
    input  wire signed [   IN_W-1:0] a,
    input  wire signed [SHIFT_W-1:0] shift,     // fraction bits dropped; negative: zeros appended
    input  wire        [        1:0] rounding,  // 0 truncate, 1 half up, 2 half even
    input  wire        [WIDTH_W-1:0] width,     // one clock later: width of the output format, in bits
    input  wire                      saturate,  // one clock later: 1 saturate, 0 wrap
    output wire signed [  OUT_W-1:0] y
);

    localparam W = (IN_W + LEFT > OUT_W ? IN_W + LEFT : OUT_W) + 1;  // holds every value below
    localparam signed [W-1:0] ONE = {{W - 1{1'b0}}, 1'b1};

    function automatic signed [W-1:0] rounded(
        input signed [IN_W-1:0] code, input signed [SHIFT_W-1:0] by, input [1:0] how
    );
        reg signed [W-1:0] v, half;
        reg [SHIFT_W-1:0] right, left;
        begin
            right = by[SHIFT_W-1] ? {SHIFT_W{1'b0}} : by;
            left = by[SHIFT_W-1] ? -by : {SHIFT_W{1'b0}};
            v = {{W - IN_W{code[IN_W-1]}}, code};
            half = right == 0 ? {W{1'b0}} : ONE <<< (right - 1'b1);
            if (how == 2'd1) v = v + half;
            if (how == 2'd2 && right != 0) v = v + half - ONE + ((v >>> right) & ONE);
            rounded = (v >>> right) <<< left;
        end
    endfunction

    reg signed [W-1:0] rounded_reg;
    always @(posedge clk) rounded_reg <= rounded(a, shift, rounding);

    // The result fits if all bits from the sign of the format upwards are equal.
    wire signed [W-1:0] above = rounded_reg >>> (width - 1'b1);
    wire fits = &above || ~|above;
    wire signed [W-1:0] ones = {W{1'b1}} <<< (width - 1'b1);  // the least code of the format
    wire sign = saturate ? rounded_reg[W-1] : above[0];
    wire signed [W-1:0] fitted = saturate && !fits ? (sign ? ones : ~ones) : (sign ? rounded_reg | ones : rounded_reg & ~ones);
    wire unused = &{1'b0, fitted[W-1:OUT_W]};  // copies of the sign

    assign y = fitted[OUT_W-1:0];

    generate
        if (IN_W < 2 || OUT_W < 2 || SHIFT_W < 2 || LEFT < 0 || WIDTH_W < 2) begin : check
            greygate_drain_parameters_are_illegal illegal ();
        end
    endgenerate

endmodule

`default_nettype wire
