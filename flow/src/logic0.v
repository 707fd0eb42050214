`timescale 1 ns / 1 ps

module logic0 (
    input [31:0] model_inp,
    output [451:0] model_out
);

    // verilator lint_off UNUSEDSIGNAL
    // Explicit quantization operation will drop bits if exists

    wire [15:0] v0; assign v0[15:0] = model_inp[15:0]; // 0
    wire [15:0] v1; assign v1[15:0] = model_inp[31:16]; // 0
    wire [19:0] v2; shift_adder #(16,16,1,1,20,0,-3,0) op_2 (v0[15:0],v0[15:0],v2[19:0]); // 1.474609375
    wire [18:0] v3; shift_adder #(16,16,1,1,19,0,-2,0) op_3 (v0[15:0],v0[15:0],v3[18:0]); // 1.474609375
    wire [18:0] v4; shift_adder #(16,16,1,1,19,0,-2,0) op_4 (v1[15:0],v1[15:0],v4[18:0]); // 1.474609375
    wire [19:0] v5; shift_adder #(16,16,1,1,20,0,3,0) op_5 (v0[15:0],v1[15:0],v5[19:0]); // 1.474609375
    wire [23:0] v6; shift_adder #(16,16,1,1,24,0,7,0) op_6 (v0[15:0],v1[15:0],v6[23:0]); // 1.474609375
    wire [17:0] v7; shift_adder #(16,16,1,1,18,0,-2,1) op_7 (v0[15:0],v0[15:0],v7[17:0]); // 1.5
    wire [17:0] v8; shift_adder #(16,16,1,1,18,0,-2,1) op_8 (v1[15:0],v1[15:0],v8[17:0]); // 1.5
    wire [20:0] v9; shift_adder #(16,16,1,1,21,0,-4,1) op_9 (v0[15:0],v1[15:0],v9[20:0]); // 1.55078125
    wire [20:0] v10; shift_adder #(16,16,1,1,21,0,4,1) op_10 (v0[15:0],v1[15:0],v10[20:0]); // 1.55078125
    wire [21:0] v11; shift_adder #(18,20,1,1,22,0,-4,0) op_11 (v8[17:0],v2[19:0],v11[21:0]); // 3.025390625
    wire [25:0] v12; shift_adder #(18,18,1,1,26,0,8,0) op_12 (v7[17:0],v7[17:0],v12[25:0]); // 3.025390625
    wire [23:0] v13; shift_adder #(21,18,1,1,24,0,6,0) op_13 (v9[20:0],v7[17:0],v13[23:0]); // 3.076171875
    wire [20:0] v14; shift_adder #(16,21,1,1,21,0,-2,1) op_14 (v1[15:0],v9[20:0],v14[20:0]); // 3.126953125
    wire [21:0] v15; ternary_adder #(16,1,0,3,16,1,1,0,21,1,1,2,22,0) op_15 (v0[15:0],v0[15:0],v9[20:0],v15[21:0]); // 3.724609375
    wire [28:0] v16; ternary_adder #(18,1,0,0,16,1,1,11,21,1,1,7,29,0) op_16 (v8[17:0],v0[15:0],v10[20:0],v16[28:0]); // 3.724609375
    wire [26:0] v17; ternary_adder #(20,1,0,0,21,1,0,3,18,1,1,9,27,0) op_17 (v2[19:0],v9[20:0],v7[17:0],v17[26:0]); // 3.806640625
    wire [27:0] v18; ternary_adder #(21,1,0,2,21,1,1,0,20,1,1,8,28,0) op_18 (v9[20:0],v9[20:0],v2[19:0],v18[27:0]); // 3.970703125
    wire [29:0] v19; ternary_adder #(16,1,0,13,16,1,1,0,20,1,1,2,30,0) op_19 (v1[15:0],v0[15:0],v2[19:0],v19[29:0]); // 3.9765625
    wire [30:0] v20; ternary_adder #(16,1,0,0,16,1,0,14,21,1,0,2,31,0) op_20 (v1[15:0],v0[15:0],v9[20:0],v20[30:0]); // 4.01171875

    // verilator lint_on UNUSEDSIGNAL

    assign model_out[15:0] = v0[15:0];
    assign model_out[31:16] = v1[15:0];
    assign model_out[50:32] = v3[18:0];
    assign model_out[69:51] = v4[18:0];
    assign model_out[89:70] = v5[19:0];
    assign model_out[113:90] = v6[23:0];
    assign model_out[131:114] = v7[17:0];
    assign model_out[149:132] = v8[17:0];
    assign model_out[170:150] = v9[20:0];
    assign model_out[191:171] = v10[20:0];
    assign model_out[213:192] = v11[21:0];
    assign model_out[239:214] = v12[25:0];
    assign model_out[263:240] = v13[23:0];
    assign model_out[284:264] = v14[20:0];
    assign model_out[306:285] = v15[21:0];
    assign model_out[335:307] = v16[28:0];
    assign model_out[362:336] = v17[26:0];
    assign model_out[390:363] = v18[27:0];
    assign model_out[420:391] = v19[29:0];
    assign model_out[451:421] = v20[30:0];

endmodule
