// SPDX-License-Identifier: MIT
// Lookup: one neuron answered from the words {base, slope} of a table of a symmetric function.
// docs/integer-program.md, "Lookup". Three clocks, and a new code in every clock:
// 1: the word of the code's segment is read, outside; 2: slope times the code's place in the segment; 3: the sum.

`default_nettype none

module greygate_lookup #(
    parameter ARG_W = 16,        // width of an argument
    parameter OUT_W = 16,        // width of a result
    parameter INTERPOLATED = 1,  // 1: a line over each segment, 0: the nearest point, in one octave
    parameter SYMMETRY = 0,      // answer to x < 0: 0 odd -y, 1 even y, 2 complement ONE - y
    parameter [OUT_W:0] ONE = 0, // 2^frac of the result, for the complement
    parameter START = 16,        // log2 of the length of the first octave
    parameter OCTAVES = 1,       // number of octaves; for each of them, the first on the right:
    parameter [8*OCTAVES-1:0] SHIFTS = 8,    // log2 of the length of a segment
    parameter [8*OCTAVES-1:0] DROPS = 0,     // low bits of a code that its place leaves out
    parameter [32*OCTAVES-1:0] FIRSTS = 0,   // address of the first segment, a multiple of the octave's number of them
    parameter COUNT = 1,         // segments of the last octave, or points
    parameter PLACE_W = 8,       // the most bits of a place: shift less drop
    parameter ADDRESS_W = 1,     // width of an address
    parameter SLOPE_FRAC = 8,    // fraction bits of a slope
    parameter GUARD = 0,         // fraction bits of a base; a base holds the rounding constant if it has any
    parameter BASE_W = 16,       // width of a base, at most OUT_W + GUARD
    parameter BASE_SIGNED = 1,   // 1: a base has a sign; 0: it is not negative
    parameter SLOPE_W = 16,      // width of a slope
    parameter SLOPE_SIGNED = 1,  // the same for slopes
    parameter MULTIPLIER = 1,    // 1: a multiplier, which may be a DSP; 0: adders
    parameter LATE = 0           // 1: words come one clock later, from a register behind the memory; four clocks in all
) (
    input  wire                 clk,
    input  wire                 en,
    input  wire [    ARG_W-1:0] x,
    output wire [ADDRESS_W-1:0] address,  // of the word that the next clock brings
    input  wire [   BASE_W-1:0] base,     // of the word that the last clock brought, or the last but one
    input  wire [  SLOPE_W-1:0] slope,
    output reg  [    OUT_W-1:0] y
);

    localparam LAST_SHIFT = SHIFTS[8*(OCTAVES-1)+:8];
    localparam LAST_PLACE = LAST_SHIFT - DROPS[8*(OCTAVES-1)+:8];
    localparam END = OCTAVES > 1 ? START + OCTAVES - 1 : 0;  // log2 of the end of the last of several octaves
    localparam M = ARG_W > LAST_SHIFT ? ARG_W : LAST_SHIFT + 1;
    localparam N = M > END ? M : END + 1;
    localparam T = (N > ADDRESS_W ? N : ADDRESS_W) + 1;  // holds |x| + half a segment, 2^END and COUNT
    localparam S = OUT_W + GUARD;                        // width of a base and of what is added to it
    localparam P = SLOPE_W + PLACE_W;                    // holds slope * 2^PLACE_W
    localparam BELOW = SLOPE_FRAC - GUARD;
    localparam V = (P > BELOW + S ? P : BELOW + S) + 1;  // a product with copies of its sign

    localparam [T-1:0] ONE_T = {{T - 1{1'b0}}, 1'b1};
    localparam [31:0] COUNT_32 = COUNT;
    localparam [T+31:0] COUNT_T = {{T{1'b0}}, COUNT_32};
    localparam [T+31:0] LAST_FIRST = {{T{1'b0}}, FIRSTS[32*(OCTAVES-1)+:32]};

    // the first clock: in the octave of the code, the address of its segment and its place there
    wire negative = x[ARG_W-1];
    wire [T-1:0] one = {{T - 1{1'b0}}, negative};
    wire [T-1:0] code = {{T - ARG_W{1'b0}}, x ^ {ARG_W{negative}}};  // |x|, or one less
    wire [OCTAVES-1:0] here;  // the octave
    wire beyond;
    wire [T*OCTAVES-1:0] segments;  // of the octave of the code; 0 for the others
    wire [T*OCTAVES-1:0] places;

    genvar o;
    generate
        for (o = 0; o < OCTAVES; o = o + 1) begin : octave
            localparam SHIFT = SHIFTS[8*o+:8];
            localparam DROP = DROPS[8*o+:8];
            localparam [T+31:0] FIRST = {{T{1'b0}}, FIRSTS[32*o+:32]};
            localparam [T-1:0] LENGTH = ONE_T << SHIFT;
            localparam [T-1:0] INNER = OCTAVES == 1 ? ~{T{1'b0}} : (ONE_T << (o == 0 ? START : START + o - 1)) - ONE_T;

            if (OCTAVES == 1) begin : only
                assign here[o] = 1'b1;
            end else if (o == 0) begin : lowest
                assign here[o] = ~|(code >> START);
            end else if (o + 1 < OCTAVES) begin : middle
                assign here[o] = ~|(code >> (START + o)) && code[START+o-1];
            end else begin : highest
                assign here[o] = |(code >> (START + o - 1));
            end

            wire [T-1:0] inner = code & INNER;  // less the least code of the octave
            wire [T-1:0] nearest = INTERPOLATED == 1 ? inner : inner + one + (LENGTH >> 1);
            wire [T-1:0] segment = nearest >> SHIFT;
            wire [T-1:0] place = ((inner & (LENGTH - ONE_T)) >> DROP) + (DROP == 0 ? one : {T{1'b0}});
            assign segments[T*o+:T] = (segment | FIRST[T-1:0]) & {T{here[o]}};
            assign places[T*o+:T] = place & {T{here[o]}};
            if (o + 1 == OCTAVES) begin : last
                assign beyond = here[o] && (segment >= COUNT_T[T-1:0] || (OCTAVES > 1 && |(code >> END)));
            end
        end
    endgenerate

    reg [T-1:0] segment_here, place_here;
    integer k;
    always @* begin
        segment_here = {T{1'b0}};
        place_here = {T{1'b0}};
        for (k = 0; k < OCTAVES; k = k + 1) begin
            segment_here = segment_here | segments[T*k+:T];
            place_here = place_here | places[T*k+:T];
        end
        if (beyond) begin  // the right end of the last segment answers for all codes beyond it
            segment_here = LAST_FIRST[T-1:0] | (COUNT_T[T-1:0] - ONE_T);
            place_here = ONE_T << LAST_PLACE;
        end
    end
    assign address = segment_here[ADDRESS_W-1:0];

    // beside the register of a late word
    wire negative_0;
    wire [T-1:0] place_0;
    generate
        if (LATE == 1) begin : late
            reg negative_late;
            reg [PLACE_W:0] place_late;
            always @(posedge clk)
                if (en) begin
                    negative_late <= negative;
                    place_late <= place_here[PLACE_W:0];
                end
            assign negative_0 = negative_late;
            assign place_0 = {{T - 1 - PLACE_W{1'b0}}, place_late};
        end else begin : prompt
            assign negative_0 = negative;
            assign place_0 = place_here;
        end
    endgenerate

    reg negative_1;
    always @(posedge clk) if (en) negative_1 <= negative_0;

    // the second clock: the base with the sign of the answer
    wire flip = negative_1 && SYMMETRY != 1;
    localparam [S+OUT_W:0] ONE_S = {{S{1'b0}}, ONE};
    localparam [S-1:0] LIFT = ({{S - 1{1'b0}}, 1'b1} + (SYMMETRY == 2 ? ONE_S[S-1:0] : {S{1'b0}})) << GUARD;
    wire [S:0] extended = {{S + 1 - BASE_W{BASE_SIGNED == 1 && base[BASE_W-1]}}, base};
    reg [S-1:0] base_2;
    always @(posedge clk) if (en) base_2 <= (extended[S-1:0] ^ {S{flip}}) + (LIFT & {S{flip}});

    generate
        if (INTERPOLATED == 1) begin : line
            reg [PLACE_W:0] place_1;
            always @(posedge clk) if (en) place_1 <= place_0[PLACE_W:0];

            wire [P-1:0] product;
            if (MULTIPLIER == 1) begin : multiplied
                wire signed [P+1:0] factor = {{P + 2 - SLOPE_W{SLOPE_SIGNED == 1 && slope[SLOPE_W-1]}}, slope};
                wire signed [P+1:0] times = {{P + 1 - PLACE_W{1'b0}}, place_1};
                wire signed [P+1:0] exact = factor * times;
                wire unused = &{1'b0, exact[P+1:P]};
                assign product = exact[P-1:0];
            end else begin : added  // 2^PLACE_W has no other bit
                wire [P-1:0] below;
                greygate_product #(
                    .A_W(SLOPE_W),
                    .SIGNED(SLOPE_SIGNED),
                    .B_W(PLACE_W)
                ) rows (
                    .a(slope),
                    .b(place_1[PLACE_W-1:0]),
                    .y(below)
                );
                assign product = below | {slope & {SLOPE_W{place_1[PLACE_W]}}, {PLACE_W{1'b0}}};
            end
            reg signed [P-1:0] product_2;
            reg flip_2;
            always @(posedge clk)
                if (en) begin
                    product_2 <= product;
                    flip_2 <= flip;
                end

            // the third clock: the base plus or minus the rounded product, in one addition with a carry
            wire [V-1:0] wide = {{V - P{SLOPE_SIGNED == 1 && product_2[P-1]}}, product_2};
            wire carry;
            if (GUARD == 0 && BELOW > 0) begin : rounded
                assign carry = wide[BELOW-1];
            end else begin : exact
                assign carry = 1'b0;
            end
            wire [S:0] sum = {base_2, 1'b1} + ({wide[BELOW+:S], carry} ^ {S + 1{flip_2}});
            always @(posedge clk) if (en) y <= sum[GUARD+1+:OUT_W];
            wire unused = &{1'b0, sum, wide, place_0, place_here, segment_here, extended[S]};
        end else begin : point
            always @(posedge clk) if (en) y <= base_2[GUARD+:OUT_W];
            wire unused = &{1'b0, slope, place_0, place_here, segment_here, extended[S]};
        end

        if (ARG_W < 2 || OUT_W < 2 || OCTAVES < 1 || COUNT < 1 || SYMMETRY < 0 || SYMMETRY > 2 || BELOW < 0 || GUARD < 0
            || BASE_W > S || (INTERPOLATED == 0 && OCTAVES > 1)) begin : check
            greygate_lookup_parameters_are_illegal illegal ();
        end
    endgenerate

endmodule

`default_nettype wire
