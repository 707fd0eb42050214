// Simulation models of ECP5 cells of which Yosys has none: what its mapping uses of them, and no more.
// A block RAM writes and reads at the rising edge of its clock, and reads what stood there before.

module MULT18X18D (
    input A17, A16, A15, A14, A13, A12, A11, A10, A9, A8, A7, A6, A5, A4, A3, A2, A1, A0,
    input B17, B16, B15, B14, B13, B12, B11, B10, B9, B8, B7, B6, B5, B4, B3, B2, B1, B0,
    input C17, C16, C15, C14, C13, C12, C11, C10, C9, C8, C7, C6, C5, C4, C3, C2, C1, C0,
    input SIGNEDA, SIGNEDB, SOURCEA, SOURCEB, CLK3, CLK2, CLK1, CLK0, CE3, CE2, CE1, CE0, RST3, RST2, RST1, RST0,
    output P35, P34, P33, P32, P31, P30, P29, P28, P27, P26, P25, P24, P23, P22, P21, P20, P19, P18, P17, P16, P15, P14, P13, P12, P11, P10, P9, P8, P7, P6, P5, P4, P3, P2, P1, P0, SIGNEDP
);
    parameter REG_INPUTA_CLK = "NONE";
    parameter REG_INPUTB_CLK = "NONE";
    parameter REG_PIPELINE_CLK = "NONE";
    parameter REG_OUTPUT_CLK = "NONE";
    wire [17:0] a = {A17, A16, A15, A14, A13, A12, A11, A10, A9, A8, A7, A6, A5, A4, A3, A2, A1, A0};
    wire [17:0] b = {B17, B16, B15, B14, B13, B12, B11, B10, B9, B8, B7, B6, B5, B4, B3, B2, B1, B0};
    wire signed [35:0] wide_a = {{18{SIGNEDA && a[17]}}, a};
    wire signed [35:0] wide_b = {{18{SIGNEDB && b[17]}}, b};
    assign {P35, P34, P33, P32, P31, P30, P29, P28, P27, P26, P25, P24, P23, P22, P21, P20, P19, P18, P17, P16, P15, P14, P13, P12, P11, P10, P9, P8, P7, P6, P5, P4, P3, P2, P1, P0} = wide_a * wide_b;
    assign SIGNEDP = SIGNEDA || SIGNEDB;
    initial if (REG_INPUTA_CLK != "NONE" || REG_INPUTB_CLK != "NONE" || REG_PIPELINE_CLK != "NONE"
        || REG_OUTPUT_CLK != "NONE" || SOURCEA || SOURCEB) $fatal(1, "MULT18X18D: registers and chains are not modelled");
endmodule

module DP16KD (
    input DIA17, DIA16, DIA15, DIA14, DIA13, DIA12, DIA11, DIA10, DIA9, DIA8, DIA7, DIA6, DIA5, DIA4, DIA3, DIA2, DIA1, DIA0,
    input ADA13, ADA12, ADA11, ADA10, ADA9, ADA8, ADA7, ADA6, ADA5, ADA4, ADA3, ADA2, ADA1, ADA0,
    input CEA, OCEA, CLKA, WEA, RSTA, CSA2, CSA1, CSA0,
    output DOA17, DOA16, DOA15, DOA14, DOA13, DOA12, DOA11, DOA10, DOA9, DOA8, DOA7, DOA6, DOA5, DOA4, DOA3, DOA2, DOA1, DOA0,
    input DIB17, DIB16, DIB15, DIB14, DIB13, DIB12, DIB11, DIB10, DIB9, DIB8, DIB7, DIB6, DIB5, DIB4, DIB3, DIB2, DIB1, DIB0,
    input ADB13, ADB12, ADB11, ADB10, ADB9, ADB8, ADB7, ADB6, ADB5, ADB4, ADB3, ADB2, ADB1, ADB0,
    input CEB, OCEB, CLKB, WEB, RSTB, CSB2, CSB1, CSB0,
    output DOB17, DOB16, DOB15, DOB14, DOB13, DOB12, DOB11, DOB10, DOB9, DOB8, DOB7, DOB6, DOB5, DOB4, DOB3, DOB2, DOB1, DOB0
);
    parameter DATA_WIDTH_A = 18;
    parameter DATA_WIDTH_B = 18;
    parameter REGMODE_A = "NOREG";
    parameter REGMODE_B = "NOREG";
    parameter RESETMODE = "SYNC";
    parameter ASYNC_RESET_RELEASE = "SYNC";
    parameter CSDECODE_A = "0b000";
    parameter CSDECODE_B = "0b000";
    parameter WRITEMODE_A = "NORMAL";
    parameter WRITEMODE_B = "NORMAL";
    parameter CLKAMUX = "CLKA";
    parameter CLKBMUX = "CLKB";
    parameter GSR = "AUTO";
    parameter INIT_DATA = "STATIC";
    parameter WID = 0;
    parameter [319:0]
        INITVAL_00 = 0, INITVAL_01 = 0, INITVAL_02 = 0, INITVAL_03 = 0, INITVAL_04 = 0, INITVAL_05 = 0, INITVAL_06 = 0, INITVAL_07 = 0,
        INITVAL_08 = 0, INITVAL_09 = 0, INITVAL_0A = 0, INITVAL_0B = 0, INITVAL_0C = 0, INITVAL_0D = 0, INITVAL_0E = 0, INITVAL_0F = 0,
        INITVAL_10 = 0, INITVAL_11 = 0, INITVAL_12 = 0, INITVAL_13 = 0, INITVAL_14 = 0, INITVAL_15 = 0, INITVAL_16 = 0, INITVAL_17 = 0,
        INITVAL_18 = 0, INITVAL_19 = 0, INITVAL_1A = 0, INITVAL_1B = 0, INITVAL_1C = 0, INITVAL_1D = 0, INITVAL_1E = 0, INITVAL_1F = 0,
        INITVAL_20 = 0, INITVAL_21 = 0, INITVAL_22 = 0, INITVAL_23 = 0, INITVAL_24 = 0, INITVAL_25 = 0, INITVAL_26 = 0, INITVAL_27 = 0,
        INITVAL_28 = 0, INITVAL_29 = 0, INITVAL_2A = 0, INITVAL_2B = 0, INITVAL_2C = 0, INITVAL_2D = 0, INITVAL_2E = 0, INITVAL_2F = 0,
        INITVAL_30 = 0, INITVAL_31 = 0, INITVAL_32 = 0, INITVAL_33 = 0, INITVAL_34 = 0, INITVAL_35 = 0, INITVAL_36 = 0, INITVAL_37 = 0,
        INITVAL_38 = 0, INITVAL_39 = 0, INITVAL_3A = 0, INITVAL_3B = 0, INITVAL_3C = 0, INITVAL_3D = 0, INITVAL_3E = 0, INITVAL_3F = 0;

    localparam [20479:0] INIT = {
        INITVAL_3F, INITVAL_3E, INITVAL_3D, INITVAL_3C, INITVAL_3B, INITVAL_3A, INITVAL_39, INITVAL_38,
        INITVAL_37, INITVAL_36, INITVAL_35, INITVAL_34, INITVAL_33, INITVAL_32, INITVAL_31, INITVAL_30,
        INITVAL_2F, INITVAL_2E, INITVAL_2D, INITVAL_2C, INITVAL_2B, INITVAL_2A, INITVAL_29, INITVAL_28,
        INITVAL_27, INITVAL_26, INITVAL_25, INITVAL_24, INITVAL_23, INITVAL_22, INITVAL_21, INITVAL_20,
        INITVAL_1F, INITVAL_1E, INITVAL_1D, INITVAL_1C, INITVAL_1B, INITVAL_1A, INITVAL_19, INITVAL_18,
        INITVAL_17, INITVAL_16, INITVAL_15, INITVAL_14, INITVAL_13, INITVAL_12, INITVAL_11, INITVAL_10,
        INITVAL_0F, INITVAL_0E, INITVAL_0D, INITVAL_0C, INITVAL_0B, INITVAL_0A, INITVAL_09, INITVAL_08,
        INITVAL_07, INITVAL_06, INITVAL_05, INITVAL_04, INITVAL_03, INITVAL_02, INITVAL_01, INITVAL_00
    };

    reg [17:0] memory[0:1023];
    integer k;
    initial begin
        for (k = 0; k < 1024; k = k + 1) memory[k] = INIT[k*20+:18];
        if (REGMODE_A != "NOREG" || REGMODE_B != "NOREG")
            $fatal(1, "DP16KD: registers at its outputs are not modelled");
    end

    // an address counts bits; of 9, 4, 2 and 1 bits there are two bytes of 9 in a word, of 36 it is two words
    function [35:0] read(input [13:0] ad, input integer width);
        reg [17:0] word;
        reg [8:0] one;
        begin
            word = memory[ad[13:4]];
            one = ad[3] ? word[17:9] : word[8:0];
            case (width)
                36: read = {memory[{ad[13:5], 1'b1}], memory[{ad[13:5], 1'b0}]};
                18: read = {18'd0, word};
                9: read = {27'd0, one};
                4: read = {32'd0, one[{ad[2], 2'b00}+:4]};
                2: read = {34'd0, one[{ad[2:1], 1'b0}+:2]};
                default: read = {35'd0, one[ad[2:0]]};
            endcase
        end
    endfunction

    function [35:0] mask(input [13:0] ad, input integer width);  // of the bits that are written, from an even word on
        reg [35:0] one;
        begin
            case (width)
                36: one = {{9{ad[3]}}, {9{ad[2]}}, {9{ad[1]}}, {9{ad[0]}}};
                18: one = {18'd0, {9{ad[1]}}, {9{ad[0]}}};
                9: one = 36'h1ff << (ad[3] ? 9 : 0);
                4: one = 36'hf << ((ad[3] ? 9 : 0) + 4 * ad[2]);
                2: one = 36'h3 << ((ad[3] ? 9 : 0) + 2 * ad[2:1]);
                default: one = 36'h1 << ((ad[3] ? 9 : 0) + ad[2:0]);
            endcase
            mask = width != 36 && ad[4] ? one << 18 : one;
        end
    endfunction

    function [35:0] placed(input [13:0] ad, input integer width, input [35:0] data);
        reg [35:0] one;
        begin
            case (width)
                36, 18: one = data;
                9: one = data << (ad[3] ? 9 : 0);
                4: one = data << ((ad[3] ? 9 : 0) + 4 * ad[2]);
                2: one = data << ((ad[3] ? 9 : 0) + 2 * ad[2:1]);
                default: one = data << ((ad[3] ? 9 : 0) + ad[2:0]);
            endcase
            placed = width != 36 && ad[4] ? one << 18 : one;
        end
    endfunction

    function [35:0] merged(input [13:0] ad, input integer width, input [35:0] data);
        merged = width == 18 ? (read(ad, width) & ~{18'd0, {9{ad[1]}}, {9{ad[0]}}}) | (data & {18'd0, {9{ad[1]}}, {9{ad[0]}}}) : data;
    endfunction

    wire [35:0] in_a = {DIB17, DIB16, DIB15, DIB14, DIB13, DIB12, DIB11, DIB10, DIB9, DIB8, DIB7, DIB6, DIB5, DIB4, DIB3, DIB2, DIB1, DIB0, DIA17, DIA16, DIA15, DIA14, DIA13, DIA12, DIA11, DIA10, DIA9, DIA8, DIA7, DIA6, DIA5, DIA4, DIA3, DIA2, DIA1, DIA0};
    wire [35:0] in_b = {18'd0, DIB17, DIB16, DIB15, DIB14, DIB13, DIB12, DIB11, DIB10, DIB9, DIB8, DIB7, DIB6, DIB5, DIB4, DIB3, DIB2, DIB1, DIB0};

    wire [13:0] ad_a = {ADA13, ADA12, ADA11, ADA10, ADA9, ADA8, ADA7, ADA6, ADA5, ADA4, ADA3, ADA2, ADA1, ADA0};
    wire clk_a = CLKAMUX == "INV" ? !CLKA : CLKA;
    reg [35:0] out_a = 0;
    always @(posedge clk_a)
        if (CEA) begin
            if (RSTA) out_a <= 0;
            else if (!WEA || WRITEMODE_A == "READBEFOREWRITE") out_a <= read(ad_a, DATA_WIDTH_A);
            else if (WRITEMODE_A == "WRITETHROUGH") out_a <= merged(ad_a, DATA_WIDTH_A, in_a);
        end

    wire [13:0] ad_b = {ADB13, ADB12, ADB11, ADB10, ADB9, ADB8, ADB7, ADB6, ADB5, ADB4, ADB3, ADB2, ADB1, ADB0};
    wire clk_b = CLKBMUX == "INV" ? !CLKB : CLKB;
    reg [35:0] out_b = 0;
    always @(posedge clk_b)
        if (CEB) begin
            if (RSTB) out_b <= 0;
            else if (!WEB || WRITEMODE_B == "READBEFOREWRITE") out_b <= read(ad_b, DATA_WIDTH_B);
            else if (WRITEMODE_B == "WRITETHROUGH") out_b <= merged(ad_b, DATA_WIDTH_B, in_b);
        end

    task store(input [13:0] ad, input [35:0] bits, input [35:0] data);
        begin
            memory[{ad[13:5], 1'b0}] <= (memory[{ad[13:5], 1'b0}] & ~bits[17:0]) | (data[17:0] & bits[17:0]);
            memory[{ad[13:5], 1'b1}] <= (memory[{ad[13:5], 1'b1}] & ~bits[35:18]) | (data[35:18] & bits[35:18]);
        end
    endtask

    always @(posedge clk_a) if (CEA && WEA) store(ad_a, mask(ad_a, DATA_WIDTH_A), placed(ad_a, DATA_WIDTH_A, in_a));
    always @(posedge clk_b) if (CEB && WEB) store(ad_b, mask(ad_b, DATA_WIDTH_B), placed(ad_b, DATA_WIDTH_B, in_b));

    wire [35:0] shown_a = RESETMODE == "ASYNC" && RSTA ? 36'd0 : out_a;
    wire [35:0] shown_b = RESETMODE == "ASYNC" && RSTB ? 36'd0 : out_b;
    assign {DOA17, DOA16, DOA15, DOA14, DOA13, DOA12, DOA11, DOA10, DOA9, DOA8, DOA7, DOA6, DOA5, DOA4, DOA3, DOA2, DOA1, DOA0} = DATA_WIDTH_B == 36 ? shown_b[17:0] : shown_a[17:0];
    assign {DOB17, DOB16, DOB15, DOB14, DOB13, DOB12, DOB11, DOB10, DOB9, DOB8, DOB7, DOB6, DOB5, DOB4, DOB3, DOB2, DOB1, DOB0} = DATA_WIDTH_B == 36 ? shown_b[35:18] : shown_b[17:0];
endmodule
