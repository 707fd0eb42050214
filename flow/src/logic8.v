`timescale 1 ns / 1 ps

module logic8 (
    input [167:0] model_inp,
    output [109:0] model_out
);

    // verilator lint_off UNUSEDSIGNAL
    // Explicit quantization operation will drop bits if exists

    wire [15:0] v0; assign v0[15:0] = model_inp[15:0]; // 24.702734375
    wire [15:0] v1; assign v1[15:0] = model_inp[31:16]; // 26.932031249999998
    wire [29:0] v2; assign v2[29:0] = model_inp[61:32]; // 33.740624999999994
    wire [29:0] v3; assign v3[29:0] = model_inp[91:62]; // 35.017968749999994
    wire [28:0] v4; assign v4[28:0] = model_inp[120:92]; // 35.750390624999994
    wire [24:0] v5; assign v5[24:0] = model_inp[145:121]; // 35.914453124999994
    wire [21:0] v6; assign v6[21:0] = model_inp[167:146]; // 36.291406249999994
    wire [29:0] v7; ternary_adder #(16,1,0,1,16,1,0,12,29,1,1,0,30,0) op_7 (v1[15:0],v0[15:0],v4[28:0],v7[29:0]); // 38.252343749999994
    wire [32:0] v8; ternary_adder #(30,1,0,2,30,1,0,0,30,1,1,2,33,0) op_8 (v2[29:0],v3[29:0],v7[29:0],v8[32:0]); // 40.795312499999994

    // verilator lint_on UNUSEDSIGNAL

    assign model_out[24:0] = v5[24:0];
    assign model_out[46:25] = v6[21:0];
    assign model_out[76:47] = v7[29:0];
    assign model_out[109:77] = v8[32:0];

endmodule
