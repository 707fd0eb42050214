// Product: a times b, exactly, without a register.
// As a multiplier of the device, or as adders: two bits of b a row, which adds 0, a, 2a or 3a to what is above the
// two low bits of the row before.

`default_nettype none

module greygate_product #(
    parameter A_W = 8,       // width of a
    parameter A_SIGNED = 0,  // 1: a has a sign
    parameter B_W = 8,       // width of b, which has none
    parameter DSP = 1        // 1: a multiplier, 0: adders
) (
    input  wire [    A_W-1:0] a,
    input  wire [    B_W-1:0] b,
    output wire [A_W+B_W-1:0] p
);

    localparam ROWS = (B_W + 1) / 2;
    localparam W = A_W + 2;  // holds 3a, and a row's sum

    wire sign = A_SIGNED == 1 && a[A_W-1];
    wire [W-1:0] once = {{2{sign}}, a};

    generate
        if (DSP == 1) begin : multiplier
            wire signed [A_W+B_W+1:0] factor = {{B_W + 2{sign}}, a};
            wire signed [A_W+B_W+1:0] times = {{A_W + 2{1'b0}}, b};
            (* use_dsp = "yes", multstyle = "dsp" *)
            wire signed [A_W+B_W+1:0] product;
            assign product = factor * times;
            assign p = product[A_W+B_W-1:0];
            wire unused = &{1'b0, product, once};
        end else begin : adders
            wire [W-1:0] thrice = {once[W-2:0], 1'b0} + once;
            wire [2*ROWS-1:0] digits = {{2 * ROWS - B_W{1'b0}}, b};
            wire [W*ROWS-1:0] sums;
            wire [2*ROWS+W-1:0] whole;
            genvar k;
            for (k = 0; k < ROWS; k = k + 1) begin : row
                wire [W-1:0] part = digits[2*k+1] ? (digits[2*k] ? thrice : {once[W-2:0], 1'b0})
                                                  : once & {W{digits[2*k]}};
                if (k == 0) begin : first
                    assign sums[0+:W] = part;
                end else begin : following
                    wire [W-1:0] before = sums[W*(k-1)+:W];
                    assign sums[W*k+:W] = {{2{A_SIGNED == 1 && before[W-1]}}, before[W-1:2]} + part;
                end
                assign whole[2*k+:2] = sums[W*k+:2];
            end
            assign whole[2*ROWS+:W] = {2'b0, sums[W*(ROWS-1)+2+:W-2]};
            assign p = whole[A_W+B_W-1:0];
            wire unused = &{1'b0, whole};
        end

        if (A_W < 1 || B_W < 1 || A_SIGNED < 0 || A_SIGNED > 1 || DSP < 0 || DSP > 1) begin : check
            greygate_product_parameters_are_illegal illegal ();
        end
    endgenerate

endmodule

`default_nettype wire
