`timescale 1 ns / 1 ps

module logic9 (
    input [109:0] model_inp,
    output [15:0] model_out
);

    // verilator lint_off UNUSEDSIGNAL
    // Explicit quantization operation will drop bits if exists

    wire [14:0] v0; assign v0[14:0] = 'b111111111111111; // 0
    wire [0:0] v1; assign v1[0:0] = 'b1; // 0
    wire [24:0] v2; assign v2[24:0] = model_inp[24:0]; // 35.914453124999994
    wire [21:0] v3; assign v3[21:0] = model_inp[46:25]; // 36.291406249999994
    wire [29:0] v4; assign v4[29:0] = model_inp[76:47]; // 38.252343749999994
    wire [32:0] v5; assign v5[32:0] = model_inp[109:77]; // 40.795312499999994
    wire [32:0] v6; ternary_adder #(25,1,0,6,30,1,0,0,33,1,0,0,33,0) op_6 (v2[24:0],v4[29:0],v5[32:0],v6[32:0]); // 43.420312499999994
    wire [32:0] v7; ternary_adder #(22,1,0,1,22,1,0,3,33,1,0,0,33,0) op_7 (v3[21:0],v3[21:0],v6[32:0],v7[32:0]); // 46.004296874999994
    wire [32:0] v8; shift_adder #(33,13,1,0,33,0,12,0) op_8 (v7[32:0],13'b1101110101101,v8[32:0]); // 46.004296874999994
    wire [19:0] v9; assign v9[19:0] = v8[32:13]; // 46.004296874999994
    wire [19:0] v10; shift_adder #(20,1,1,0,20,0,15,0) op_10 (v9[19:0],1'b1,v10[19:0]); // 46.004296874999994
    wire [19:0] v11; mux #(1,20,1,1,20,-15) op_11 (v10[19],v1[0:0],v9[19:0],v11[19:0]); // 46.504296874999994
    wire [19:0] v12; shift_adder #(20,15,1,0,20,0,0,1) op_12 (v11[19:0],15'b111111111111111,v12[19:0]); // 46.504296874999994
    wire [15:0] v13; mux #(20,15,1,0,16,0) op_13 (v12[19],v11[19:0],v0[14:0],v13[15:0]); // 47.004296874999994

    // verilator lint_on UNUSEDSIGNAL

    assign model_out[15:0] = v13[15:0];

endmodule
