// Lookup: one neuron answered from the words {base, slope} of a table of a symmetric function.
// docs/integer-program.md, "Lookup". Three clocks, and a new code in every clock:
// 1: the word of the code's segment is read, outside; 2: slope times the code's place in the segment; 3: the sum.
// A negative code x is looked up as ~x, one less than its absolute value, at a place that is one further.

`default_nettype none

module greygate_lookup #(
    parameter ARG_W = 16,        // width of an argument
    parameter OUT_W = 16,        // width of a result
    parameter SHIFT = 8,         // log2 of the length of a segment, in argument codes
    parameter LAST = 1,          // address of the last word
    parameter ADDRESS_W = 1,     // width of an address
    parameter INTERPOLATED = 1,  // 1: base is the left end of a segment, 0: base is the nearest point
    parameter SYMMETRY = 0,      // answer to x < 0: 0 odd -y, 1 even y, 2 complement ONE - y
    parameter [OUT_W:0] ONE = 0, // 2^frac of the result, for the complement
    parameter BASE_W = 16,       // width of a base
    parameter BASE_SIGNED = 1,   // 1: a base has a sign; 0: it is not negative
    parameter SLOPE_W = 16,      // width of a slope, at most OUT_W
    parameter SLOPE_SIGNED = 1   // the same for slopes
) (
    input  wire                 clk,
    input  wire                 en,
    input  wire [    ARG_W-1:0] x,
    output wire [ADDRESS_W-1:0] address,  // of the word that the next clock brings
    input  wire [   BASE_W-1:0] base,     // of the word that the last clock brought
    input  wire [  SLOPE_W-1:0] slope,
    output reg  [    OUT_W-1:0] y
);

    localparam M = ARG_W > SHIFT ? ARG_W : SHIFT + 1;     // holds |x| and 2^SHIFT
    localparam T = (M > ADDRESS_W ? M : ADDRESS_W) + 1;   // holds |x| + 2^(SHIFT-1) and LAST + 1
    localparam P = SLOPE_W + SHIFT;                       // holds slope * 2^SHIFT
    localparam W = (SLOPE_W + SHIFT + 2 > OUT_W + SHIFT ? SLOPE_W + SHIFT + 2 : OUT_W + SHIFT);

    localparam [T-1:0] LENGTH = {{T - 1{1'b0}}, 1'b1} << SHIFT;
    localparam [T-1:0] MASK = LENGTH - {{T - 1{1'b0}}, 1'b1};
    localparam [31:0] WORDS_32 = LAST + 1;
    localparam [T+31:0] WORDS = {{T{1'b0}}, WORDS_32};
    localparam [31:0] LAST_32 = LAST;

    // the first clock
    wire negative = x[ARG_W-1];
    wire [T-1:0] one = {{T - 1{1'b0}}, negative};
    wire [T-1:0] code = {{T - ARG_W{1'b0}}, x ^ {ARG_W{negative}}};
    wire [T-1:0] index = INTERPOLATED == 1 ? code >> SHIFT : (code + one + (LENGTH >> 1)) >> SHIFT;
    wire beyond = index >= WORDS[T-1:0];
    assign address = beyond ? LAST_32[ADDRESS_W-1:0] : index[ADDRESS_W-1:0];

    reg negative_1;
    always @(posedge clk) if (en) negative_1 <= negative;

    // the second clock: the base with the sign of the answer
    wire flip = negative_1 && SYMMETRY != 1;
    wire [OUT_W-1:0] lift = {{OUT_W - 1{1'b0}}, 1'b1} + (SYMMETRY == 2 ? ONE[OUT_W-1:0] : {OUT_W{1'b0}});
    wire [OUT_W-1:0] extended;
    reg [OUT_W-1:0] base_2;
    always @(posedge clk) if (en) base_2 <= (extended ^ {OUT_W{flip}}) + (lift & {OUT_W{flip}});

    generate
        if (BASE_W < OUT_W) begin : narrow
            assign extended = {{OUT_W - BASE_W{BASE_SIGNED == 1 && base[BASE_W-1]}}, base};
        end else begin : wide
            assign extended = base;
        end

        if (INTERPOLATED == 1) begin : line
            // the place in the segment, up to its length: the right end answers for all that lies beyond the last
            wire [T-1:0] place = beyond ? LENGTH : (code & MASK) + one;
            reg [SHIFT:0] place_1;
            always @(posedge clk) if (en) place_1 <= place[SHIFT:0];

            wire signed [W-1:0] factor = {{W - SLOPE_W{SLOPE_SIGNED == 1 && slope[SLOPE_W-1]}}, slope};
            wire signed [W-1:0] times = {{W - SHIFT - 1{1'b0}}, place_1};
            wire signed [W-1:0] product = factor * times;
            reg [P-1:0] product_2;
            reg flip_2;
            always @(posedge clk)
                if (en) begin
                    product_2 <= product[P-1:0];
                    flip_2 <= flip;
                end

            // the third clock: base + ((product + half) >> SHIFT), or base minus it, in one addition with a carry
            wire [OUT_W:0] rise = {{OUT_W + 1 - SLOPE_W{SLOPE_SIGNED == 1 && product_2[P-1]}}, product_2[P-1:SHIFT]};
            wire carry;
            if (SHIFT > 0) begin : rounded
                assign carry = product_2[SHIFT-1];
            end else begin : exact
                assign carry = 1'b0;
            end
            wire [OUT_W+1:0] sum = {1'b0, base_2, 1'b1} + ({rise, carry} ^ {OUT_W + 2{flip_2}});
            wire unused = &{1'b0, sum[OUT_W+1], sum[0], product[W-1:P], product_2, place};
            always @(posedge clk) if (en) y <= sum[OUT_W:1];
        end else begin : point
            wire unused = &{1'b0, slope};
            always @(posedge clk) if (en) y <= base_2;
        end

        if (ARG_W < 2 || OUT_W < 2 || SHIFT < 0 || LAST < 0 || SYMMETRY < 0 || SYMMETRY > 2 || SLOPE_W > OUT_W
            || BASE_W > OUT_W) begin : check
            greygate_lookup_parameters_are_illegal illegal ();
        end
    endgenerate

endmodule

`default_nettype wire
