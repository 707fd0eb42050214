`timescale 1 ns / 1 ps

module logic5 (
    input [395:0] model_inp,
    output [165:0] model_out
);

    // verilator lint_off UNUSEDSIGNAL
    // Explicit quantization operation will drop bits if exists

    wire [0:0] v0; assign v0[0:0] = 'b1; // 0
    wire [30:0] v1; assign v1[30:0] = model_inp[30:0]; // 17.575
    wire [29:0] v2; assign v2[29:0] = model_inp[60:31]; // 18.018359375
    wire [32:0] v3; assign v3[32:0] = model_inp[93:61]; // 18.32578125
    wire [31:0] v4; assign v4[31:0] = model_inp[125:94]; // 18.674609375
    wire [31:0] v5; assign v5[31:0] = model_inp[157:126]; // 18.715625
    wire [29:0] v6; assign v6[29:0] = model_inp[187:158]; // 18.819140625
    wire [27:0] v7; assign v7[27:0] = model_inp[215:188]; // 19.155859375
    wire [29:0] v8; assign v8[29:0] = model_inp[245:216]; // 19.886328125
    wire [11:0] v9; assign v9[11:0] = model_inp[257:246]; // 20.643359375
    wire [31:0] v10; assign v10[31:0] = model_inp[289:258]; // 21.273046875
    wire [11:0] v11; assign v11[11:0] = model_inp[301:290]; // 21.273046875
    wire [11:0] v12; assign v12[11:0] = model_inp[313:302]; // 21.53984375
    wire [11:0] v13; assign v13[11:0] = model_inp[325:314]; // 21.627734375
    wire [11:0] v14; assign v14[11:0] = model_inp[337:326]; // 22.665625
    wire [31:0] v15; assign v15[31:0] = model_inp[369:338]; // 23.22734375
    wire [12:0] v16; assign v16[12:0] = model_inp[382:370]; // 23.22734375
    wire [12:0] v17; assign v17[12:0] = model_inp[395:383]; // 23.22734375
    wire [15:0] v18; table_f1d33660_bfd9_41b4_8bd5_15d7f505ef56 op_18 (v9, v18[15:0]); // 23.718359375
    wire [11:0] v19; mux #(1,13,1,1,12,-11) op_19 (v17[12],v0[0:0],v16[12:0],v19[11:0]); // 23.72734375
    wire [31:0] v20; ternary_adder #(30,1,1,0,32,1,1,0,32,1,0,0,32,0) op_20 (v2[29:0],v4[31:0],v10[31:0],v20[31:0]); // 23.85703125
    wire [31:0] v21; shift_adder #(32,13,1,0,32,0,16,1) op_21 (v20[31:0],13'b1001000111101,v21[31:0]); // 23.85703125
    wire [31:0] v22; negative #(32, 32, 1) op_22 (v21, v22[31:0]); // 23.85703125
    wire [11:0] v23; assign v23[11:0] = v22[31:20]; // 23.85703125
    wire [15:0] v24; table_a71fd47a_a0f3_4084_a225_7a43853e41f6 op_24 (v11, v24[15:0]); // 24.348046874999998
    wire [15:0] v25; table_861da07f_c917_4f7c_aec9_6f834a51f1f0 op_25 (v12, v25[15:0]); // 24.61484375
    wire [15:0] v26; table_39dffa81_94d9_4770_abbf_9a07b6f7eded op_26 (v13, v26[15:0]); // 24.702734375
    wire [15:0] v27; table_aef69ca3_e702_4976_962e_ec568e473c01 op_27 (v14, v27[15:0]); // 25.740624999999998
    wire [31:0] v28; ternary_adder #(28,1,0,0,33,1,0,0,32,1,0,0,32,0) op_28 (v7[27:0],v3[32:0],v15[31:0],v28[31:0]); // 25.811328125
    wire [31:0] v29; shift_adder #(32,15,1,0,32,0,14,1) op_29 (v28[31:0],15'b100010100011101,v29[31:0]); // 25.811328125
    wire [11:0] v30; assign v30[11:0] = v29[31:20]; // 25.811328125
    wire [17:0] v31; shift_adder #(16,16,1,1,18,0,1,0) op_31 (v25[15:0],v24[15:0],v31[17:0]); // 26.089453125
    wire [31:0] v32; ternary_adder #(31,1,0,0,30,1,0,0,32,1,0,0,32,0) op_32 (v1[30:0],v8[29:0],v20[31:0],v32[31:0]); // 26.441015625
    wire [31:0] v33; ternary_adder #(30,1,0,0,32,1,0,0,32,1,0,0,32,0) op_33 (v6[29:0],v5[31:0],v20[31:0],v33[31:0]); // 26.441015625
    wire [31:0] v34; shift_adder #(32,10,1,0,32,0,16,0) op_34 (v32[31:0],10'b1110110011,v34[31:0]); // 26.441015625
    wire [31:0] v35; shift_adder #(32,11,1,0,32,0,15,1) op_35 (v33[31:0],11'b10010000001,v35[31:0]); // 26.441015625
    wire [11:0] v36; assign v36[11:0] = v35[31:20]; // 26.441015625
    wire [11:0] v37; assign v37[11:0] = v34[31:20]; // 26.441015625
    wire [15:0] v38; table_04d69f4d_1691_45de_82f1_2fce85c2524f op_38 (v19, v38[15:0]); // 26.80234375
    wire [15:0] v39; table_7616634e_5493_4f63_bddb_4d6e6dd11f70 op_39 (v23, v39[15:0]); // 26.932031249999998

    // verilator lint_on UNUSEDSIGNAL

    assign model_out[15:0] = v18[15:0];
    assign model_out[31:16] = v24[15:0];
    assign model_out[47:32] = v25[15:0];
    assign model_out[63:48] = v26[15:0];
    assign model_out[79:64] = v27[15:0];
    assign model_out[91:80] = v30[11:0];
    assign model_out[109:92] = v31[17:0];
    assign model_out[121:110] = v36[11:0];
    assign model_out[133:122] = v37[11:0];
    assign model_out[149:134] = v38[15:0];
    assign model_out[165:150] = v39[15:0];

endmodule
