// SPDX-License-Identifier: MIT
// Threshold: for each of SIZE codes, ABOVE from AT upwards, BELOW otherwise.
// docs/integer-program.md, "THRESHOLD". One clock: y follows x when en is high.

`default_nettype none

module greygate_threshold #(
    parameter SIZE = 1,    // number of codes side by side in x and y
    parameter ARG_W = 16,  // width of an argument
    parameter OUT_W = 16,  // width of a result
    parameter signed [ARG_W-1:0] AT = 0,     // the least code answered with ABOVE
    parameter signed [OUT_W-1:0] BELOW = 0,  // the answer below AT
    parameter signed [OUT_W-1:0] ABOVE = 1   // the answer from AT upwards
) (
    input  wire                  clk,
    input  wire                  en,
    input  wire [SIZE*ARG_W-1:0] x,
    output reg  [SIZE*OUT_W-1:0] y
);

    function automatic [OUT_W-1:0] threshold(input signed [ARG_W-1:0] code);
        threshold = code >= AT ? ABOVE : BELOW;
    endfunction

    integer n;
    always @(posedge clk)
        if (en) for (n = 0; n < SIZE; n = n + 1) y[n*OUT_W+:OUT_W] <= threshold(x[n*ARG_W+:ARG_W]);

    generate
        if (SIZE < 1 || ARG_W < 2 || OUT_W < 2) begin : check
            greygate_threshold_parameters_are_illegal illegal ();
        end
    endgenerate

endmodule

`default_nettype wire
