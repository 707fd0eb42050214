// SPDX-License-Identifier: MIT
// Clamp: SIZE codes limited to [LO, HI], then brought to the output format, saturating.
// docs/integer-program.md, "CLAMP". One clock: y follows x when en is high.

`default_nettype none

module greygate_clamp #(
    parameter SIZE = 1,      // number of codes side by side in x and y
    parameter ARG_W = 16,    // width of an argument
    parameter OUT_W = 16,    // width of a result
    parameter SHIFT = 0,     // fraction bits dropped; negative: zeros appended
    parameter ROUNDING = 1,  // 0 truncate, 1 half up, 2 half even
    parameter signed [ARG_W-1:0] LO = 0,  // least code let through
    parameter signed [ARG_W-1:0] HI = 0   // greatest code let through
) (
    input  wire                  clk,
    input  wire                  en,
    input  wire [SIZE*ARG_W-1:0] x,
    output wire [SIZE*OUT_W-1:0] y
);

    localparam W = (SHIFT > ARG_W ? SHIFT : ARG_W) + 1;  // the rounding constant fits as well

    function automatic [W-1:0] clamp(input signed [ARG_W-1:0] code);
        reg signed [ARG_W-1:0] v;
        begin
            v = code < LO ? LO : code > HI ? HI : code;
            clamp = {{W - ARG_W{v[ARG_W-1]}}, v};
        end
    endfunction

    genvar n;
    generate
        for (n = 0; n < SIZE; n = n + 1) begin : element
            greygate_requantize #(
                .IN_W(W),
                .OUT_W(OUT_W),
                .SHIFT(SHIFT),
                .ROUNDING(ROUNDING),
                .SATURATE(1)
            ) requantize (
                .clk(clk),
                .en(en),
                .a(clamp(x[n*ARG_W+:ARG_W])),
                .y(y[n*OUT_W+:OUT_W])
            );
        end
        if (SIZE < 1 || ARG_W < 2 || LO > HI) begin : check
            greygate_clamp_parameters_are_illegal illegal ();
        end
    endgenerate

endmodule

`default_nettype wire
