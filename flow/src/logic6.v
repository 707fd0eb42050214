`timescale 1 ns / 1 ps

module logic6 (
    input [165:0] model_inp,
    output [253:0] model_out
);

    // verilator lint_off UNUSEDSIGNAL
    // Explicit quantization operation will drop bits if exists

    wire [15:0] v0; assign v0[15:0] = model_inp[15:0]; // 23.718359375
    wire [15:0] v1; assign v1[15:0] = model_inp[31:16]; // 24.348046874999998
    wire [15:0] v2; assign v2[15:0] = model_inp[47:32]; // 24.61484375
    wire [15:0] v3; assign v3[15:0] = model_inp[63:48]; // 24.702734375
    wire [15:0] v4; assign v4[15:0] = model_inp[79:64]; // 25.740624999999998
    wire [11:0] v5; assign v5[11:0] = model_inp[91:80]; // 25.811328125
    wire [17:0] v6; assign v6[17:0] = model_inp[109:92]; // 26.089453125
    wire [11:0] v7; assign v7[11:0] = model_inp[121:110]; // 26.441015625
    wire [11:0] v8; assign v8[11:0] = model_inp[133:122]; // 26.441015625
    wire [15:0] v9; assign v9[15:0] = model_inp[149:134]; // 26.80234375
    wire [15:0] v10; assign v10[15:0] = model_inp[165:150]; // 26.932031249999998
    wire [16:0] v11; shift_adder #(16,16,1,1,17,0,0,1) op_11 (v9[15:0],v4[15:0],v11[16:0]); // 28.2515625
    wire [22:0] v12; shift_adder #(16,16,1,1,23,0,-6,1) op_12 (v0[15:0],v9[15:0],v12[22:0]); // 28.40390625
    wire [15:0] v13; table_e284d194_ccc0_4638_b786_997f50037f6f op_13 (v5, v13[15:0]); // 28.886328125
    wire [21:0] v14; ternary_adder #(16,1,0,4,16,1,1,5,16,1,1,0,22,0) op_14 (v0[15:0],v3[15:0],v9[15:0],v14[21:0]); // 28.976171875
    wire [15:0] v15; table_8dcf8a47_6ea0_4b7a_a1ac_3e06dcaf2d0c op_15 (v7, v15[15:0]); // 29.516015624999998
    wire [15:0] v16; table_2888f48a_45a1_4565_9e0f_fc4b095879e1 op_16 (v8, v16[15:0]); // 29.516015624999998
    wire [21:0] v17; shift_adder #(16,16,1,1,22,0,-5,0) op_17 (v10[15:0],v16[15:0],v17[21:0]); // 30.990624999999998
    wire [17:0] v18; ternary_adder #(16,1,1,0,16,1,0,0,16,1,0,0,18,0) op_18 (v1[15:0],v2[15:0],v15[15:0],v18[17:0]); // 31.525781249999998
    wire [21:0] v19; shift_adder #(16,22,1,1,22,0,-4,0) op_19 (v13[15:0],v17[21:0],v19[21:0]); // 32.516015624999994

    // verilator lint_on UNUSEDSIGNAL

    assign model_out[15:0] = v0[15:0];
    assign model_out[31:16] = v3[15:0];
    assign model_out[47:32] = v4[15:0];
    assign model_out[65:48] = v6[17:0];
    assign model_out[81:66] = v10[15:0];
    assign model_out[98:82] = v11[16:0];
    assign model_out[121:99] = v12[22:0];
    assign model_out[137:122] = v13[15:0];
    assign model_out[159:138] = v14[21:0];
    assign model_out[175:160] = v15[15:0];
    assign model_out[191:176] = v16[15:0];
    assign model_out[213:192] = v17[21:0];
    assign model_out[231:214] = v18[17:0];
    assign model_out[253:232] = v19[21:0];

endmodule
