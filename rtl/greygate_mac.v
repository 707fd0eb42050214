// Multiply-accumulate: acc = bias + w[0] x[0] + w[1] x[1] + ..., exact. Two clocks from x to acc.

`default_nettype none

module greygate_mac #(
    parameter X_W = 16,       // width of a code
    parameter WEIGHT_W = 16,  // width of a weight
    parameter ACC_W = 40      // width of the sum; proved from the formats that no sum overflows it
) (
    input  wire                       clk,
    input  wire signed [     X_W-1:0] x,
    input  wire signed [WEIGHT_W-1:0] weight,
    input  wire                       first,  // the product before this clock opens a sum: start at bias
    input  wire                       next,   // the product before this clock is one of a sum
    input  wire signed [   ACC_W-1:0] bias,
    output reg  signed [   ACC_W-1:0] acc
);

    localparam P = X_W + WEIGHT_W;
    localparam W = (P > ACC_W ? P : ACC_W) + 1;

    reg signed [P-1:0] product_reg;
    wire signed [W-1:0] sum = {{W - P{product_reg[P-1]}}, product_reg}
        + (first ? {{W - ACC_W{bias[ACC_W-1]}}, bias} : {{W - ACC_W{acc[ACC_W-1]}}, acc});
    wire unused = &{1'b0, sum[W-1:ACC_W]};  // copies of the sign

    always @(posedge clk) begin
        product_reg <= {{WEIGHT_W{x[X_W-1]}}, x} * {{X_W{weight[WEIGHT_W-1]}}, weight};
        if (first || next) acc <= sum[ACC_W-1:0];
    end

    generate
        if (X_W < 2 || WEIGHT_W < 2 || ACC_W < 2) begin : check
            greygate_mac_parameters_are_illegal illegal ();
        end
    endgenerate

endmodule

`default_nettype wire
