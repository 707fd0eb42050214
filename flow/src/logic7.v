`timescale 1 ns / 1 ps

module logic7 (
    input [253:0] model_inp,
    output [167:0] model_out
);

    // verilator lint_off UNUSEDSIGNAL
    // Explicit quantization operation will drop bits if exists

    wire [15:0] v0; assign v0[15:0] = model_inp[15:0]; // 23.718359375
    wire [15:0] v1; assign v1[15:0] = model_inp[31:16]; // 24.702734375
    wire [15:0] v2; assign v2[15:0] = model_inp[47:32]; // 25.740624999999998
    wire [17:0] v3; assign v3[17:0] = model_inp[65:48]; // 26.089453125
    wire [15:0] v4; assign v4[15:0] = model_inp[81:66]; // 26.932031249999998
    wire [16:0] v5; assign v5[16:0] = model_inp[98:82]; // 28.2515625
    wire [22:0] v6; assign v6[22:0] = model_inp[121:99]; // 28.40390625
    wire [15:0] v7; assign v7[15:0] = model_inp[137:122]; // 28.886328125
    wire [21:0] v8; assign v8[21:0] = model_inp[159:138]; // 28.976171875
    wire [15:0] v9; assign v9[15:0] = model_inp[175:160]; // 29.516015624999998
    wire [15:0] v10; assign v10[15:0] = model_inp[191:176]; // 29.516015624999998
    wire [21:0] v11; assign v11[21:0] = model_inp[213:192]; // 30.990624999999998
    wire [17:0] v12; assign v12[17:0] = model_inp[231:214]; // 31.525781249999998
    wire [21:0] v13; assign v13[21:0] = model_inp[253:232]; // 32.516015624999994
    wire [21:0] v14; ternary_adder #(16,1,1,0,16,1,1,1,18,1,0,4,22,0) op_14 (v9[15:0],v0[15:0],v12[17:0],v14[21:0]); // 33.699609374999994
    wire [29:0] v15; ternary_adder #(22,1,0,0,18,1,1,7,18,1,1,12,30,0) op_15 (v8[21:0],v3[17:0],v12[17:0],v15[29:0]); // 33.740624999999994
    wire [21:0] v16; ternary_adder #(16,1,1,2,22,1,0,0,16,1,0,0,22,0) op_16 (v2[15:0],v13[21:0],v1[15:0],v16[21:0]); // 34.689843749999994
    wire [29:0] v17; ternary_adder #(23,1,1,5,17,1,1,0,22,1,0,8,30,0) op_17 (v6[22:0],v5[16:0],v13[21:0],v17[29:0]); // 35.017968749999994
    wire [28:0] v18; ternary_adder #(16,1,0,10,17,1,0,11,22,1,0,0,29,0) op_18 (v10[15:0],v5[16:0],v14[21:0],v18[28:0]); // 35.750390624999994
    wire [24:0] v19; ternary_adder #(22,1,0,0,23,1,1,2,22,1,0,2,25,0) op_19 (v11[21:0],v6[22:0],v14[21:0],v19[24:0]); // 35.914453124999994
    wire [21:0] v20; shift_adder #(16,22,1,1,22,0,0,1) op_20 (v7[15:0],v16[21:0],v20[21:0]); // 36.291406249999994

    // verilator lint_on UNUSEDSIGNAL

    assign model_out[15:0] = v1[15:0];
    assign model_out[31:16] = v4[15:0];
    assign model_out[61:32] = v15[29:0];
    assign model_out[91:62] = v17[29:0];
    assign model_out[120:92] = v18[28:0];
    assign model_out[145:121] = v19[24:0];
    assign model_out[167:146] = v20[21:0];

endmodule
