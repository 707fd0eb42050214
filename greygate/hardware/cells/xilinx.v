// Simulation models of 7-series block RAM, of which Yosys has only the timing: what its mapping uses of them, and no more.
// A port writes and reads at the rising edge of its clock; the other port's write of the same clock is not seen.

module RAMB18E1 (
    output [15:0] DOADO, DOBDO,
    output [1:0] DOPADOP, DOPBDOP,
    input [13:0] ADDRARDADDR, ADDRBWRADDR,
    input CLKARDCLK, CLKBWRCLK, ENARDEN, ENBWREN, REGCEAREGCE, REGCEB, RSTRAMARSTRAM, RSTRAMB, RSTREGARSTREG, RSTREGB,
    input [15:0] DIADI, DIBDI,
    input [1:0] DIPADIP, DIPBDIP,
    input [1:0] WEA,
    input [3:0] WEBWE
);
    parameter integer DOA_REG = 0;
    parameter integer DOB_REG = 0;
    parameter [17:0] INIT_A = 0;
    parameter [17:0] INIT_B = 0;
    parameter [17:0] SRVAL_A = 0;
    parameter [17:0] SRVAL_B = 0;
    parameter INIT_FILE = "NONE";
    parameter RAM_MODE = "TDP";
    parameter RAM_EXTENSION_A = "NONE";
    parameter RAM_EXTENSION_B = "NONE";
    parameter EN_ECC_READ = "FALSE";
    parameter EN_ECC_WRITE = "FALSE";
    parameter RDADDR_COLLISION_HWCONFIG = "DELAYED_WRITE";
    parameter SIM_COLLISION_CHECK = "ALL";
    parameter SIM_DEVICE = "7SERIES";
    parameter RSTREG_PRIORITY_A = "RSTREG";
    parameter RSTREG_PRIORITY_B = "RSTREG";
    parameter integer READ_WIDTH_A = 0;
    parameter integer READ_WIDTH_B = 0;
    parameter integer WRITE_WIDTH_A = 0;
    parameter integer WRITE_WIDTH_B = 0;
    parameter WRITE_MODE_A = "WRITE_FIRST";
    parameter WRITE_MODE_B = "WRITE_FIRST";
    parameter IS_CLKARDCLK_INVERTED = 1'b0;
    parameter IS_CLKBWRCLK_INVERTED = 1'b0;
    parameter IS_ENARDEN_INVERTED = 1'b0;
    parameter IS_ENBWREN_INVERTED = 1'b0;
    parameter IS_RSTRAMARSTRAM_INVERTED = 1'b0;
    parameter IS_RSTRAMB_INVERTED = 1'b0;
    parameter IS_RSTREGARSTREG_INVERTED = 1'b0;
    parameter IS_RSTREGB_INVERTED = 1'b0;
    parameter [255:0] INIT_00 = 0;
    parameter [255:0] INIT_01 = 0;
    parameter [255:0] INIT_02 = 0;
    parameter [255:0] INIT_03 = 0;
    parameter [255:0] INIT_04 = 0;
    parameter [255:0] INIT_05 = 0;
    parameter [255:0] INIT_06 = 0;
    parameter [255:0] INIT_07 = 0;
    parameter [255:0] INIT_08 = 0;
    parameter [255:0] INIT_09 = 0;
    parameter [255:0] INIT_0A = 0;
    parameter [255:0] INIT_0B = 0;
    parameter [255:0] INIT_0C = 0;
    parameter [255:0] INIT_0D = 0;
    parameter [255:0] INIT_0E = 0;
    parameter [255:0] INIT_0F = 0;
    parameter [255:0] INIT_10 = 0;
    parameter [255:0] INIT_11 = 0;
    parameter [255:0] INIT_12 = 0;
    parameter [255:0] INIT_13 = 0;
    parameter [255:0] INIT_14 = 0;
    parameter [255:0] INIT_15 = 0;
    parameter [255:0] INIT_16 = 0;
    parameter [255:0] INIT_17 = 0;
    parameter [255:0] INIT_18 = 0;
    parameter [255:0] INIT_19 = 0;
    parameter [255:0] INIT_1A = 0;
    parameter [255:0] INIT_1B = 0;
    parameter [255:0] INIT_1C = 0;
    parameter [255:0] INIT_1D = 0;
    parameter [255:0] INIT_1E = 0;
    parameter [255:0] INIT_1F = 0;
    parameter [255:0] INIT_20 = 0;
    parameter [255:0] INIT_21 = 0;
    parameter [255:0] INIT_22 = 0;
    parameter [255:0] INIT_23 = 0;
    parameter [255:0] INIT_24 = 0;
    parameter [255:0] INIT_25 = 0;
    parameter [255:0] INIT_26 = 0;
    parameter [255:0] INIT_27 = 0;
    parameter [255:0] INIT_28 = 0;
    parameter [255:0] INIT_29 = 0;
    parameter [255:0] INIT_2A = 0;
    parameter [255:0] INIT_2B = 0;
    parameter [255:0] INIT_2C = 0;
    parameter [255:0] INIT_2D = 0;
    parameter [255:0] INIT_2E = 0;
    parameter [255:0] INIT_2F = 0;
    parameter [255:0] INIT_30 = 0;
    parameter [255:0] INIT_31 = 0;
    parameter [255:0] INIT_32 = 0;
    parameter [255:0] INIT_33 = 0;
    parameter [255:0] INIT_34 = 0;
    parameter [255:0] INIT_35 = 0;
    parameter [255:0] INIT_36 = 0;
    parameter [255:0] INIT_37 = 0;
    parameter [255:0] INIT_38 = 0;
    parameter [255:0] INIT_39 = 0;
    parameter [255:0] INIT_3A = 0;
    parameter [255:0] INIT_3B = 0;
    parameter [255:0] INIT_3C = 0;
    parameter [255:0] INIT_3D = 0;
    parameter [255:0] INIT_3E = 0;
    parameter [255:0] INIT_3F = 0;
    parameter [255:0] INITP_00 = 0;
    parameter [255:0] INITP_01 = 0;
    parameter [255:0] INITP_02 = 0;
    parameter [255:0] INITP_03 = 0;
    parameter [255:0] INITP_04 = 0;
    parameter [255:0] INITP_05 = 0;
    parameter [255:0] INITP_06 = 0;
    parameter [255:0] INITP_07 = 0;

    localparam [16383:0] INIT = {
        INIT_3F, INIT_3E, INIT_3D, INIT_3C, INIT_3B, INIT_3A, INIT_39, INIT_38,
        INIT_37, INIT_36, INIT_35, INIT_34, INIT_33, INIT_32, INIT_31, INIT_30,
        INIT_2F, INIT_2E, INIT_2D, INIT_2C, INIT_2B, INIT_2A, INIT_29, INIT_28,
        INIT_27, INIT_26, INIT_25, INIT_24, INIT_23, INIT_22, INIT_21, INIT_20,
        INIT_1F, INIT_1E, INIT_1D, INIT_1C, INIT_1B, INIT_1A, INIT_19, INIT_18,
        INIT_17, INIT_16, INIT_15, INIT_14, INIT_13, INIT_12, INIT_11, INIT_10,
        INIT_0F, INIT_0E, INIT_0D, INIT_0C, INIT_0B, INIT_0A, INIT_09, INIT_08,
        INIT_07, INIT_06, INIT_05, INIT_04, INIT_03, INIT_02, INIT_01, INIT_00
    };
    localparam [2047:0] INITP = {
        INITP_07, INITP_06, INITP_05, INITP_04, INITP_03, INITP_02, INITP_01, INITP_00
    };
    localparam SDP = RAM_MODE == "SDP";

    // one entry of memory is as wide as the widest port; an address counts bits of data
    reg [31:0] memory[0:511];
    reg [3:0] parity[0:511];
    integer k;
    initial begin
        for (k = 0; k < 512; k = k + 1) begin
            memory[k] = INIT[k*32+:32];
            parity[k] = INITP[k*4+:4];
        end
        if (DOA_REG != 0 || DOB_REG != 0 || RAM_EXTENSION_A != "NONE" || RAM_EXTENSION_B != "NONE" || EN_ECC_READ != "FALSE")
            $fatal(1, "RAMB18E1: registers at its outputs, cascades and ECC are not modelled");
    end

    function integer bits(input integer width);  // of data
        bits = width == 72 ? 64 : width == 36 ? 32 : width == 18 ? 16 : width == 9 ? 8 : width;
    endfunction

    wire clk_a = CLKARDCLK ^ IS_CLKARDCLK_INVERTED, clk_b = CLKBWRCLK ^ IS_CLKBWRCLK_INVERTED;
    wire en_a = ENARDEN ^ IS_ENARDEN_INVERTED, en_b = ENBWREN ^ IS_ENBWREN_INVERTED;
    wire rst_a = RSTRAMARSTRAM ^ IS_RSTRAMARSTRAM_INVERTED, rst_b = RSTRAMB ^ IS_RSTRAMB_INVERTED;
    wire [13:0] at_a = ADDRARDADDR[13:0], at_b = ADDRBWRADDR[13:0];
    wire [8:0] entry_a = at_a[13:5], entry_b = at_b[13:5];

    // the place of a port's bits in an entry
    function [4:0] place(input [4:0] at, input integer width);
        place = at & ~(bits(width) - 1);
    endfunction

    wire [31:0] data_a = memory[entry_a] >> place(at_a[4:0], READ_WIDTH_A);
    wire [3:0] extra_a = parity[entry_a] >> (place(at_a[4:0], READ_WIDTH_A) >> 3);
    wire [31:0] data_b = memory[entry_b] >> place(at_b[4:0], READ_WIDTH_B);
    wire [3:0] extra_b = parity[entry_b] >> (place(at_b[4:0], READ_WIDTH_B) >> 3);

    wire [31:0] given_b = SDP && WRITE_WIDTH_B == 36 ? {DIBDI, DIADI} : {16'd0, DIBDI};
    wire [3:0] given_pb = SDP && WRITE_WIDTH_B == 36 ? {DIPBDIP, DIPADIP} : {2'd0, DIPBDIP};

    // which bits a port writes: those of its width, byte by byte as WE says
    function [31:0] written(input [4:0] at, input integer width, input [3:0] we);
        integer n;
        begin
            written = 0;
            for (n = 0; n < 32; n = n + 1) if (n < bits(width)) written[n] = we[n/8];
            written = written << place(at, width);
        end
    endfunction
    function [3:0] written_parity(input [4:0] at, input integer width, input [3:0] we);
        integer n;
        begin
            written_parity = 0;
            for (n = 0; n < 4; n = n + 1) if (n < bits(width) / 8) written_parity[n] = we[n];
            written_parity = written_parity << (place(at, width) >> 3);
        end
    endfunction

    wire [3:0] we_a = SDP || WRITE_WIDTH_A == 0 ? 0 : {2'd0, WEA};
    wire [3:0] we_b = WRITE_WIDTH_B == 0 ? 0 : WEBWE;
    wire [31:0] mask_a = written(at_a[4:0], WRITE_WIDTH_A, we_a), mask_b = written(at_b[4:0], WRITE_WIDTH_B, we_b);
    wire [3:0] mask_pa = written_parity(at_a[4:0], WRITE_WIDTH_A, we_a);
    wire [3:0] mask_pb = written_parity(at_b[4:0], WRITE_WIDTH_B, we_b);

    reg [31:0] out_a = {INIT_B[15:0], INIT_A[15:0]};
    reg [3:0] out_pa = {INIT_B[17:16], INIT_A[17:16]};
    reg [15:0] out_b = INIT_B[15:0];
    reg [1:0] out_pb = INIT_B[17:16];

    always @(posedge clk_a) if (en_a) begin
        if (|we_a) begin
            memory[entry_a] <= (memory[entry_a] & ~mask_a) | (({16'd0, DIADI} << place(at_a[4:0], WRITE_WIDTH_A)) & mask_a);
            parity[entry_a] <= (parity[entry_a] & ~mask_pa) | (({2'd0, DIPADIP} << (place(at_a[4:0], WRITE_WIDTH_A) >> 3)) & mask_pa);
        end
        if (rst_a) {out_pa, out_a} <= {SRVAL_B[17:16], SRVAL_A[17:16], SRVAL_B[15:0], SRVAL_A[15:0]};
        else if (~|we_a || WRITE_MODE_A == "READ_FIRST") {out_pa, out_a} <= {extra_a, data_a};
        else if (WRITE_MODE_A == "WRITE_FIRST") {out_pa, out_a} <= {2'd0, DIPADIP, 16'd0, DIADI};
    end
    always @(posedge clk_b) if (en_b) begin
        if (|we_b) begin
            memory[entry_b] <= (memory[entry_b] & ~mask_b) | ((given_b << place(at_b[4:0], WRITE_WIDTH_B)) & mask_b);
            parity[entry_b] <= (parity[entry_b] & ~mask_pb) | ((given_pb << (place(at_b[4:0], WRITE_WIDTH_B) >> 3)) & mask_pb);
        end
        if (rst_b) {out_pb, out_b} <= {SRVAL_B[17:16], SRVAL_B[15:0]};
        else if (~|we_b || WRITE_MODE_B == "READ_FIRST") {out_pb, out_b} <= {extra_b[1:0], data_b[15:0]};
        else if (WRITE_MODE_B == "WRITE_FIRST") {out_pb, out_b} <= {DIPBDIP, DIBDI};
    end
    assign DOADO = out_a[15:0];
    assign DOPADOP = out_pa[1:0];
    assign DOBDO = SDP && READ_WIDTH_A == 36 ? out_a[31:16] : out_b;
    assign DOPBDOP = SDP && READ_WIDTH_A == 36 ? out_pa[3:2] : out_pb;
endmodule

module RAMB36E1 (
    output CASCADEOUTA, CASCADEOUTB,
    output [7:0] ECCPARITY,
    output [8:0] RDADDRECC,
    output SBITERR, DBITERR,
    input CASCADEINA, CASCADEINB, INJECTDBITERR, INJECTSBITERR,
    output [31:0] DOADO, DOBDO,
    output [3:0] DOPADOP, DOPBDOP,
    input [15:0] ADDRARDADDR, ADDRBWRADDR,
    input CLKARDCLK, CLKBWRCLK, ENARDEN, ENBWREN, REGCEAREGCE, REGCEB, RSTRAMARSTRAM, RSTRAMB, RSTREGARSTREG, RSTREGB,
    input [31:0] DIADI, DIBDI,
    input [3:0] DIPADIP, DIPBDIP,
    input [3:0] WEA,
    input [7:0] WEBWE
);
    parameter integer DOA_REG = 0;
    parameter integer DOB_REG = 0;
    parameter [35:0] INIT_A = 0;
    parameter [35:0] INIT_B = 0;
    parameter [35:0] SRVAL_A = 0;
    parameter [35:0] SRVAL_B = 0;
    parameter INIT_FILE = "NONE";
    parameter RAM_MODE = "TDP";
    parameter RAM_EXTENSION_A = "NONE";
    parameter RAM_EXTENSION_B = "NONE";
    parameter EN_ECC_READ = "FALSE";
    parameter EN_ECC_WRITE = "FALSE";
    parameter RDADDR_COLLISION_HWCONFIG = "DELAYED_WRITE";
    parameter SIM_COLLISION_CHECK = "ALL";
    parameter SIM_DEVICE = "7SERIES";
    parameter RSTREG_PRIORITY_A = "RSTREG";
    parameter RSTREG_PRIORITY_B = "RSTREG";
    parameter integer READ_WIDTH_A = 0;
    parameter integer READ_WIDTH_B = 0;
    parameter integer WRITE_WIDTH_A = 0;
    parameter integer WRITE_WIDTH_B = 0;
    parameter WRITE_MODE_A = "WRITE_FIRST";
    parameter WRITE_MODE_B = "WRITE_FIRST";
    parameter IS_CLKARDCLK_INVERTED = 1'b0;
    parameter IS_CLKBWRCLK_INVERTED = 1'b0;
    parameter IS_ENARDEN_INVERTED = 1'b0;
    parameter IS_ENBWREN_INVERTED = 1'b0;
    parameter IS_RSTRAMARSTRAM_INVERTED = 1'b0;
    parameter IS_RSTRAMB_INVERTED = 1'b0;
    parameter IS_RSTREGARSTREG_INVERTED = 1'b0;
    parameter IS_RSTREGB_INVERTED = 1'b0;
    parameter [255:0] INIT_00 = 0;
    parameter [255:0] INIT_01 = 0;
    parameter [255:0] INIT_02 = 0;
    parameter [255:0] INIT_03 = 0;
    parameter [255:0] INIT_04 = 0;
    parameter [255:0] INIT_05 = 0;
    parameter [255:0] INIT_06 = 0;
    parameter [255:0] INIT_07 = 0;
    parameter [255:0] INIT_08 = 0;
    parameter [255:0] INIT_09 = 0;
    parameter [255:0] INIT_0A = 0;
    parameter [255:0] INIT_0B = 0;
    parameter [255:0] INIT_0C = 0;
    parameter [255:0] INIT_0D = 0;
    parameter [255:0] INIT_0E = 0;
    parameter [255:0] INIT_0F = 0;
    parameter [255:0] INIT_10 = 0;
    parameter [255:0] INIT_11 = 0;
    parameter [255:0] INIT_12 = 0;
    parameter [255:0] INIT_13 = 0;
    parameter [255:0] INIT_14 = 0;
    parameter [255:0] INIT_15 = 0;
    parameter [255:0] INIT_16 = 0;
    parameter [255:0] INIT_17 = 0;
    parameter [255:0] INIT_18 = 0;
    parameter [255:0] INIT_19 = 0;
    parameter [255:0] INIT_1A = 0;
    parameter [255:0] INIT_1B = 0;
    parameter [255:0] INIT_1C = 0;
    parameter [255:0] INIT_1D = 0;
    parameter [255:0] INIT_1E = 0;
    parameter [255:0] INIT_1F = 0;
    parameter [255:0] INIT_20 = 0;
    parameter [255:0] INIT_21 = 0;
    parameter [255:0] INIT_22 = 0;
    parameter [255:0] INIT_23 = 0;
    parameter [255:0] INIT_24 = 0;
    parameter [255:0] INIT_25 = 0;
    parameter [255:0] INIT_26 = 0;
    parameter [255:0] INIT_27 = 0;
    parameter [255:0] INIT_28 = 0;
    parameter [255:0] INIT_29 = 0;
    parameter [255:0] INIT_2A = 0;
    parameter [255:0] INIT_2B = 0;
    parameter [255:0] INIT_2C = 0;
    parameter [255:0] INIT_2D = 0;
    parameter [255:0] INIT_2E = 0;
    parameter [255:0] INIT_2F = 0;
    parameter [255:0] INIT_30 = 0;
    parameter [255:0] INIT_31 = 0;
    parameter [255:0] INIT_32 = 0;
    parameter [255:0] INIT_33 = 0;
    parameter [255:0] INIT_34 = 0;
    parameter [255:0] INIT_35 = 0;
    parameter [255:0] INIT_36 = 0;
    parameter [255:0] INIT_37 = 0;
    parameter [255:0] INIT_38 = 0;
    parameter [255:0] INIT_39 = 0;
    parameter [255:0] INIT_3A = 0;
    parameter [255:0] INIT_3B = 0;
    parameter [255:0] INIT_3C = 0;
    parameter [255:0] INIT_3D = 0;
    parameter [255:0] INIT_3E = 0;
    parameter [255:0] INIT_3F = 0;
    parameter [255:0] INIT_40 = 0;
    parameter [255:0] INIT_41 = 0;
    parameter [255:0] INIT_42 = 0;
    parameter [255:0] INIT_43 = 0;
    parameter [255:0] INIT_44 = 0;
    parameter [255:0] INIT_45 = 0;
    parameter [255:0] INIT_46 = 0;
    parameter [255:0] INIT_47 = 0;
    parameter [255:0] INIT_48 = 0;
    parameter [255:0] INIT_49 = 0;
    parameter [255:0] INIT_4A = 0;
    parameter [255:0] INIT_4B = 0;
    parameter [255:0] INIT_4C = 0;
    parameter [255:0] INIT_4D = 0;
    parameter [255:0] INIT_4E = 0;
    parameter [255:0] INIT_4F = 0;
    parameter [255:0] INIT_50 = 0;
    parameter [255:0] INIT_51 = 0;
    parameter [255:0] INIT_52 = 0;
    parameter [255:0] INIT_53 = 0;
    parameter [255:0] INIT_54 = 0;
    parameter [255:0] INIT_55 = 0;
    parameter [255:0] INIT_56 = 0;
    parameter [255:0] INIT_57 = 0;
    parameter [255:0] INIT_58 = 0;
    parameter [255:0] INIT_59 = 0;
    parameter [255:0] INIT_5A = 0;
    parameter [255:0] INIT_5B = 0;
    parameter [255:0] INIT_5C = 0;
    parameter [255:0] INIT_5D = 0;
    parameter [255:0] INIT_5E = 0;
    parameter [255:0] INIT_5F = 0;
    parameter [255:0] INIT_60 = 0;
    parameter [255:0] INIT_61 = 0;
    parameter [255:0] INIT_62 = 0;
    parameter [255:0] INIT_63 = 0;
    parameter [255:0] INIT_64 = 0;
    parameter [255:0] INIT_65 = 0;
    parameter [255:0] INIT_66 = 0;
    parameter [255:0] INIT_67 = 0;
    parameter [255:0] INIT_68 = 0;
    parameter [255:0] INIT_69 = 0;
    parameter [255:0] INIT_6A = 0;
    parameter [255:0] INIT_6B = 0;
    parameter [255:0] INIT_6C = 0;
    parameter [255:0] INIT_6D = 0;
    parameter [255:0] INIT_6E = 0;
    parameter [255:0] INIT_6F = 0;
    parameter [255:0] INIT_70 = 0;
    parameter [255:0] INIT_71 = 0;
    parameter [255:0] INIT_72 = 0;
    parameter [255:0] INIT_73 = 0;
    parameter [255:0] INIT_74 = 0;
    parameter [255:0] INIT_75 = 0;
    parameter [255:0] INIT_76 = 0;
    parameter [255:0] INIT_77 = 0;
    parameter [255:0] INIT_78 = 0;
    parameter [255:0] INIT_79 = 0;
    parameter [255:0] INIT_7A = 0;
    parameter [255:0] INIT_7B = 0;
    parameter [255:0] INIT_7C = 0;
    parameter [255:0] INIT_7D = 0;
    parameter [255:0] INIT_7E = 0;
    parameter [255:0] INIT_7F = 0;
    parameter [255:0] INITP_00 = 0;
    parameter [255:0] INITP_01 = 0;
    parameter [255:0] INITP_02 = 0;
    parameter [255:0] INITP_03 = 0;
    parameter [255:0] INITP_04 = 0;
    parameter [255:0] INITP_05 = 0;
    parameter [255:0] INITP_06 = 0;
    parameter [255:0] INITP_07 = 0;
    parameter [255:0] INITP_08 = 0;
    parameter [255:0] INITP_09 = 0;
    parameter [255:0] INITP_0A = 0;
    parameter [255:0] INITP_0B = 0;
    parameter [255:0] INITP_0C = 0;
    parameter [255:0] INITP_0D = 0;
    parameter [255:0] INITP_0E = 0;
    parameter [255:0] INITP_0F = 0;

    localparam [32767:0] INIT = {
        INIT_7F, INIT_7E, INIT_7D, INIT_7C, INIT_7B, INIT_7A, INIT_79, INIT_78,
        INIT_77, INIT_76, INIT_75, INIT_74, INIT_73, INIT_72, INIT_71, INIT_70,
        INIT_6F, INIT_6E, INIT_6D, INIT_6C, INIT_6B, INIT_6A, INIT_69, INIT_68,
        INIT_67, INIT_66, INIT_65, INIT_64, INIT_63, INIT_62, INIT_61, INIT_60,
        INIT_5F, INIT_5E, INIT_5D, INIT_5C, INIT_5B, INIT_5A, INIT_59, INIT_58,
        INIT_57, INIT_56, INIT_55, INIT_54, INIT_53, INIT_52, INIT_51, INIT_50,
        INIT_4F, INIT_4E, INIT_4D, INIT_4C, INIT_4B, INIT_4A, INIT_49, INIT_48,
        INIT_47, INIT_46, INIT_45, INIT_44, INIT_43, INIT_42, INIT_41, INIT_40,
        INIT_3F, INIT_3E, INIT_3D, INIT_3C, INIT_3B, INIT_3A, INIT_39, INIT_38,
        INIT_37, INIT_36, INIT_35, INIT_34, INIT_33, INIT_32, INIT_31, INIT_30,
        INIT_2F, INIT_2E, INIT_2D, INIT_2C, INIT_2B, INIT_2A, INIT_29, INIT_28,
        INIT_27, INIT_26, INIT_25, INIT_24, INIT_23, INIT_22, INIT_21, INIT_20,
        INIT_1F, INIT_1E, INIT_1D, INIT_1C, INIT_1B, INIT_1A, INIT_19, INIT_18,
        INIT_17, INIT_16, INIT_15, INIT_14, INIT_13, INIT_12, INIT_11, INIT_10,
        INIT_0F, INIT_0E, INIT_0D, INIT_0C, INIT_0B, INIT_0A, INIT_09, INIT_08,
        INIT_07, INIT_06, INIT_05, INIT_04, INIT_03, INIT_02, INIT_01, INIT_00
    };
    localparam [4095:0] INITP = {
        INITP_0F, INITP_0E, INITP_0D, INITP_0C, INITP_0B, INITP_0A, INITP_09, INITP_08,
        INITP_07, INITP_06, INITP_05, INITP_04, INITP_03, INITP_02, INITP_01, INITP_00
    };
    localparam SDP = RAM_MODE == "SDP";

    // one entry of memory is as wide as the widest port; an address counts bits of data
    reg [63:0] memory[0:511];
    reg [7:0] parity[0:511];
    integer k;
    initial begin
        for (k = 0; k < 512; k = k + 1) begin
            memory[k] = INIT[k*64+:64];
            parity[k] = INITP[k*8+:8];
        end
        if (DOA_REG != 0 || DOB_REG != 0 || RAM_EXTENSION_A != "NONE" || RAM_EXTENSION_B != "NONE" || EN_ECC_READ != "FALSE")
            $fatal(1, "RAMB36E1: registers at its outputs, cascades and ECC are not modelled");
    end

    function integer bits(input integer width);  // of data
        bits = width == 72 ? 64 : width == 36 ? 32 : width == 18 ? 16 : width == 9 ? 8 : width;
    endfunction

    wire clk_a = CLKARDCLK ^ IS_CLKARDCLK_INVERTED, clk_b = CLKBWRCLK ^ IS_CLKBWRCLK_INVERTED;
    wire en_a = ENARDEN ^ IS_ENARDEN_INVERTED, en_b = ENBWREN ^ IS_ENBWREN_INVERTED;
    wire rst_a = RSTRAMARSTRAM ^ IS_RSTRAMARSTRAM_INVERTED, rst_b = RSTRAMB ^ IS_RSTRAMB_INVERTED;
    wire [14:0] at_a = ADDRARDADDR[14:0], at_b = ADDRBWRADDR[14:0];
    wire [8:0] entry_a = at_a[14:6], entry_b = at_b[14:6];

    // the place of a port's bits in an entry
    function [5:0] place(input [5:0] at, input integer width);
        place = at & ~(bits(width) - 1);
    endfunction

    wire [63:0] data_a = memory[entry_a] >> place(at_a[5:0], READ_WIDTH_A);
    wire [7:0] extra_a = parity[entry_a] >> (place(at_a[5:0], READ_WIDTH_A) >> 3);
    wire [63:0] data_b = memory[entry_b] >> place(at_b[5:0], READ_WIDTH_B);
    wire [7:0] extra_b = parity[entry_b] >> (place(at_b[5:0], READ_WIDTH_B) >> 3);

    wire [63:0] given_b = SDP && WRITE_WIDTH_B == 72 ? {DIBDI, DIADI} : {32'd0, DIBDI};
    wire [7:0] given_pb = SDP && WRITE_WIDTH_B == 72 ? {DIPBDIP, DIPADIP} : {4'd0, DIPBDIP};

    // which bits a port writes: those of its width, byte by byte as WE says
    function [63:0] written(input [5:0] at, input integer width, input [7:0] we);
        integer n;
        begin
            written = 0;
            for (n = 0; n < 64; n = n + 1) if (n < bits(width)) written[n] = we[n/8];
            written = written << place(at, width);
        end
    endfunction
    function [7:0] written_parity(input [5:0] at, input integer width, input [7:0] we);
        integer n;
        begin
            written_parity = 0;
            for (n = 0; n < 8; n = n + 1) if (n < bits(width) / 8) written_parity[n] = we[n];
            written_parity = written_parity << (place(at, width) >> 3);
        end
    endfunction

    wire [7:0] we_a = SDP || WRITE_WIDTH_A == 0 ? 0 : {4'd0, WEA};
    wire [7:0] we_b = WRITE_WIDTH_B == 0 ? 0 : WEBWE;
    wire [63:0] mask_a = written(at_a[5:0], WRITE_WIDTH_A, we_a), mask_b = written(at_b[5:0], WRITE_WIDTH_B, we_b);
    wire [7:0] mask_pa = written_parity(at_a[5:0], WRITE_WIDTH_A, we_a);
    wire [7:0] mask_pb = written_parity(at_b[5:0], WRITE_WIDTH_B, we_b);

    reg [63:0] out_a = {INIT_B[31:0], INIT_A[31:0]};
    reg [7:0] out_pa = {INIT_B[35:32], INIT_A[35:32]};
    reg [31:0] out_b = INIT_B[31:0];
    reg [3:0] out_pb = INIT_B[35:32];

    always @(posedge clk_a) if (en_a) begin
        if (|we_a) begin
            memory[entry_a] <= (memory[entry_a] & ~mask_a) | (({32'd0, DIADI} << place(at_a[5:0], WRITE_WIDTH_A)) & mask_a);
            parity[entry_a] <= (parity[entry_a] & ~mask_pa) | (({4'd0, DIPADIP} << (place(at_a[5:0], WRITE_WIDTH_A) >> 3)) & mask_pa);
        end
        if (rst_a) {out_pa, out_a} <= {SRVAL_B[35:32], SRVAL_A[35:32], SRVAL_B[31:0], SRVAL_A[31:0]};
        else if (~|we_a || WRITE_MODE_A == "READ_FIRST") {out_pa, out_a} <= {extra_a, data_a};
        else if (WRITE_MODE_A == "WRITE_FIRST") {out_pa, out_a} <= {4'd0, DIPADIP, 32'd0, DIADI};
    end
    always @(posedge clk_b) if (en_b) begin
        if (|we_b) begin
            memory[entry_b] <= (memory[entry_b] & ~mask_b) | ((given_b << place(at_b[5:0], WRITE_WIDTH_B)) & mask_b);
            parity[entry_b] <= (parity[entry_b] & ~mask_pb) | ((given_pb << (place(at_b[5:0], WRITE_WIDTH_B) >> 3)) & mask_pb);
        end
        if (rst_b) {out_pb, out_b} <= {SRVAL_B[35:32], SRVAL_B[31:0]};
        else if (~|we_b || WRITE_MODE_B == "READ_FIRST") {out_pb, out_b} <= {extra_b[3:0], data_b[31:0]};
        else if (WRITE_MODE_B == "WRITE_FIRST") {out_pb, out_b} <= {DIPBDIP, DIBDI};
    end
    assign DOADO = out_a[31:0];
    assign DOPADOP = out_pa[3:0];
    assign DOBDO = SDP && READ_WIDTH_A == 72 ? out_a[63:32] : out_b;
    assign DOPBDOP = SDP && READ_WIDTH_A == 72 ? out_pa[7:4] : out_pb;
endmodule
