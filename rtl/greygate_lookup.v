// Lookup: SIZE equal neurons answered from one table of a symmetric function.
// docs/integer-program.md, "Lookup". One clock: y follows x when en is high.
// The points beyond the last repeat it, so that "i >= n" needs no case of its own.

`default_nettype none

module greygate_lookup #(
    parameter SIZE = 1,          // number of codes side by side in x and y
    parameter ARG_W = 16,        // width of an argument
    parameter OUT_W = 16,        // width of a result
    parameter SHIFT = 8,         // log2 of the distance of two points, in argument codes
    parameter LAST = 1,          // index of the last point
    parameter INTERPOLATED = 1,  // 1 linear between points, 0 the nearest point
    parameter SYMMETRY = 0,      // answer to x < 0: 0 odd -y, 1 even y, 2 complement ONE - y
    parameter [OUT_W:0] ONE = 0, // 2^frac of the result, for the complement
    parameter [(LAST+1)*OUT_W-1:0] POINTS = 0  // points[LAST], ..., points[1], points[0]
) (
    input  wire                  clk,
    input  wire                  en,
    input  wire [SIZE*ARG_W-1:0] x,
    output reg  [SIZE*OUT_W-1:0] y
);

    localparam INDEX_W = LAST > 0 ? $clog2(LAST + 1) : 1;
    localparam WIDER = ARG_W > INDEX_W ? ARG_W : INDEX_W;
    localparam A = (WIDER > SHIFT ? WIDER : SHIFT) + 1;  // holds |x| + half, LAST and 2^SHIFT
    localparam P = OUT_W + A + 2;                        // holds (difference of points) * |x|

    localparam [A-1:0] STEP = {{A - 1{1'b0}}, 1'b1} << SHIFT;
    localparam [A-1:0] MASK = STEP - {{A - 1{1'b0}}, 1'b1};
    localparam [31:0] LAST_32 = LAST;
    localparam [A+31:0] LAST_A = {{A{1'b0}}, LAST_32};

    reg signed [OUT_W-1:0] points[0:LAST];
    integer k;
    initial for (k = 0; k <= LAST; k = k + 1) points[k] = POINTS[k*OUT_W+:OUT_W];

    function automatic [INDEX_W-1:0] limited(input [A-1:0] index);
        limited = index > LAST_A[A-1:0] ? LAST_A[INDEX_W-1:0] : index[INDEX_W-1:0];
    endfunction

    function automatic [OUT_W-1:0] lookup(input [ARG_W-1:0] code);
        reg [A-1:0] a, i;
        reg signed [OUT_W-1:0] p, q;
        reg signed [P-1:0] base, step, r, v;
        begin
            a = {{A - ARG_W{code[ARG_W-1]}}, code};
            if (code[ARG_W-1]) a = -a;
            i = INTERPOLATED == 1 ? a >> SHIFT : (a + (STEP >> 1)) >> SHIFT;
            p = points[limited(i)];
            q = points[limited(i + {{A - 1{1'b0}}, 1'b1})];
            base = {{P - OUT_W{p[OUT_W-1]}}, p};
            step = {{P - OUT_W{q[OUT_W-1]}}, q} - base;
            r = {{P - A{1'b0}}, a & MASK};
            v = base;
            if (INTERPOLATED == 1) v = base + ((step * r + {{P - A{1'b0}}, STEP >> 1}) >>> SHIFT);
            if (code[ARG_W-1] && SYMMETRY == 0) v = -v;
            if (code[ARG_W-1] && SYMMETRY == 2) v = {{P - OUT_W - 1{1'b0}}, ONE} - v;
            lookup = v[OUT_W-1:0];
        end
    endfunction

    integer n;
    always @(posedge clk)
        if (en) for (n = 0; n < SIZE; n = n + 1) y[n*OUT_W+:OUT_W] <= lookup(x[n*ARG_W+:ARG_W]);

    generate
        if (SIZE < 1 || ARG_W < 2 || OUT_W < 2 || SHIFT < 0 || LAST < 0 || SYMMETRY < 0 || SYMMETRY > 2) begin : check
            greygate_lookup_parameters_are_illegal illegal ();
        end
    endgenerate

endmodule

`default_nettype wire
