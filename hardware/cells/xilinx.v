// Simulation models of 7-series block RAM, of which Yosys has only the timing: what its mapping uses of them, and no more.
// A port writes and reads at the rising edge of its clock; the other port's write of the same clock is not seen.

module greygate_block_ram (
    output [DATA-1:0] DOADO, DOBDO,
    output [PARITY-1:0] DOPADOP, DOPBDOP,
    input [PLACES-1:0] at_a, at_b,  // count bits of data
    input clk_a, clk_b, en_a, en_b, rst_a, rst_b,
    input [DATA-1:0] DIADI, DIBDI,
    input [PARITY-1:0] DIPADIP, DIPBDIP,
    input [PARITY-1:0] WEA,
    input [2*PARITY-1:0] WEBWE
);
    parameter DATA = 16;  // bits of one port, without parity; one entry of the memory is as wide as both ports together
    parameter READ_WIDTH_A = 0, READ_WIDTH_B = 0, WRITE_WIDTH_A = 0, WRITE_WIDTH_B = 0;
    parameter WRITE_MODE_A = "WRITE_FIRST", WRITE_MODE_B = "WRITE_FIRST";
    parameter SDP = 0;
    parameter [1024*DATA-1:0] INIT = 0;
    parameter [128*DATA-1:0] INITP = 0;
    parameter [DATA+DATA/8-1:0] INIT_A = 0, INIT_B = 0, SRVAL_A = 0, SRVAL_B = 0;
    localparam PARITY = DATA / 8;
    localparam PLACES = $clog2(1024 * DATA);
    localparam WITHIN = $clog2(2 * DATA);  // bits of the place in an entry
    localparam BOTH = 9 * DATA / 4;        // width of both ports together

    reg [2*DATA-1:0] memory[0:511];
    reg [2*PARITY-1:0] parity[0:511];
    integer k;
    initial
        for (k = 0; k < 512; k = k + 1) begin
            memory[k] = INIT[k*2*DATA+:2*DATA];
            parity[k] = INITP[k*2*PARITY+:2*PARITY];
        end

    function integer bits(input integer width);  // of data
        bits = width % 9 == 0 ? width / 9 * 8 : width;
    endfunction

    // the place of a port's bits in an entry
    function [WITHIN-1:0] place(input [WITHIN-1:0] at, input integer width);
        place = width == 0 ? 0 : at & ~(bits(width) - 1);
    endfunction

    wire [8:0] entry_a = at_a[PLACES-1:WITHIN], entry_b = at_b[PLACES-1:WITHIN];
    wire [WITHIN-1:0] read_a = place(at_a[WITHIN-1:0], READ_WIDTH_A), write_a = place(at_a[WITHIN-1:0], WRITE_WIDTH_A);
    wire [WITHIN-1:0] read_b = place(at_b[WITHIN-1:0], READ_WIDTH_B), write_b = place(at_b[WITHIN-1:0], WRITE_WIDTH_B);

    wire [2*DATA-1:0] data_a = memory[entry_a] >> read_a, data_b = memory[entry_b] >> read_b;
    wire [2*PARITY-1:0] extra_a = parity[entry_a] >> (read_a >> 3), extra_b = parity[entry_b] >> (read_b >> 3);

    // which bits a port writes, before they are shifted to their place: those of its width, byte by byte as WE says
    function [2*DATA-1:0] written(input integer width, input [2*PARITY-1:0] we);
        integer n;
        for (n = 0; n < 2 * DATA; n = n + 1) written[n] = n < bits(width) && we[n/8];
    endfunction
    function [2*PARITY-1:0] written_parity(input integer width, input [2*PARITY-1:0] we);
        integer n;
        for (n = 0; n < 2 * PARITY; n = n + 1) written_parity[n] = n < bits(width) / 8 && we[n];
    endfunction

    wire wide = SDP != 0 && WRITE_WIDTH_B == BOTH;
    wire [2*DATA-1:0] given_a = {{DATA{1'b0}}, DIADI}, given_b = wide ? {DIBDI, DIADI} : {{DATA{1'b0}}, DIBDI};
    wire [2*PARITY-1:0] given_pa = {{PARITY{1'b0}}, DIPADIP};
    wire [2*PARITY-1:0] given_pb = wide ? {DIPBDIP, DIPADIP} : {{PARITY{1'b0}}, DIPBDIP};
    wire [2*PARITY-1:0] we_a = SDP != 0 || WRITE_WIDTH_A == 0 ? 0 : {{PARITY{1'b0}}, WEA};
    wire [2*PARITY-1:0] we_b = WRITE_WIDTH_B == 0 ? 0 : WEBWE;
    wire [2*DATA-1:0] mask_a = written(WRITE_WIDTH_A, we_a) << write_a, mask_b = written(WRITE_WIDTH_B, we_b) << write_b;
    wire [2*PARITY-1:0] mask_pa = written_parity(WRITE_WIDTH_A, we_a) << (write_a >> 3);
    wire [2*PARITY-1:0] mask_pb = written_parity(WRITE_WIDTH_B, we_b) << (write_b >> 3);

    // what both ports together read is the answer of A
    localparam [2*DATA-1:0] FIRST = {INIT_B[DATA-1:0], INIT_A[DATA-1:0]}, RESET = {SRVAL_B[DATA-1:0], SRVAL_A[DATA-1:0]};
    localparam [2*PARITY-1:0] FIRST_P = {INIT_B[DATA+:PARITY], INIT_A[DATA+:PARITY]};
    localparam [2*PARITY-1:0] RESET_P = {SRVAL_B[DATA+:PARITY], SRVAL_A[DATA+:PARITY]};
    reg [2*DATA-1:0] out_a = FIRST;
    reg [2*PARITY-1:0] out_pa = FIRST_P;
    reg [DATA-1:0] out_b = INIT_B[DATA-1:0];
    reg [PARITY-1:0] out_pb = INIT_B[DATA+:PARITY];

    always @(posedge clk_a) if (en_a) begin
        if (|we_a) begin
            memory[entry_a] <= (memory[entry_a] & ~mask_a) | ((given_a << write_a) & mask_a);
            parity[entry_a] <= (parity[entry_a] & ~mask_pa) | ((given_pa << (write_a >> 3)) & mask_pa);
        end
        if (rst_a) {out_pa, out_a} <= {RESET_P, RESET};
        else if (~|we_a || WRITE_MODE_A == "READ_FIRST") {out_pa, out_a} <= {extra_a, data_a};
        else if (WRITE_MODE_A == "WRITE_FIRST") {out_pa, out_a} <= {given_pa, given_a};
    end
    always @(posedge clk_b) if (en_b) begin
        if (|we_b) begin
            memory[entry_b] <= (memory[entry_b] & ~mask_b) | ((given_b << write_b) & mask_b);
            parity[entry_b] <= (parity[entry_b] & ~mask_pb) | ((given_pb << (write_b >> 3)) & mask_pb);
        end
        if (rst_b) {out_pb, out_b} <= {SRVAL_B[DATA+:PARITY], SRVAL_B[DATA-1:0]};
        else if (~|we_b || WRITE_MODE_B == "READ_FIRST") {out_pb, out_b} <= {extra_b[PARITY-1:0], data_b[DATA-1:0]};
        else if (WRITE_MODE_B == "WRITE_FIRST") {out_pb, out_b} <= {DIPBDIP, DIBDI};
    end

    assign {DOPADOP, DOADO} = {out_pa[PARITY-1:0], out_a[DATA-1:0]};
    assign {DOPBDOP, DOBDO} = SDP != 0 && READ_WIDTH_A == BOTH
        ? {out_pa[PARITY+:PARITY], out_a[DATA+:DATA]} : {out_pb, out_b};
endmodule

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
    parameter integer DOA_REG = 0, DOB_REG = 0;
    parameter integer READ_WIDTH_A = 0, READ_WIDTH_B = 0, WRITE_WIDTH_A = 0, WRITE_WIDTH_B = 0;
    parameter WRITE_MODE_A = "WRITE_FIRST", WRITE_MODE_B = "WRITE_FIRST";
    parameter RAM_MODE = "TDP", RAM_EXTENSION_A = "NONE", RAM_EXTENSION_B = "NONE";
    parameter EN_ECC_READ = "FALSE", EN_ECC_WRITE = "FALSE";
    parameter INIT_FILE = "NONE", SIM_COLLISION_CHECK = "ALL", SIM_DEVICE = "7SERIES";
    parameter RDADDR_COLLISION_HWCONFIG = "DELAYED_WRITE", RSTREG_PRIORITY_A = "RSTREG", RSTREG_PRIORITY_B = "RSTREG";
    parameter IS_CLKARDCLK_INVERTED = 1'b0, IS_CLKBWRCLK_INVERTED = 1'b0, IS_ENARDEN_INVERTED = 1'b0;
    parameter IS_ENBWREN_INVERTED = 1'b0, IS_RSTRAMARSTRAM_INVERTED = 1'b0, IS_RSTRAMB_INVERTED = 1'b0;
    parameter IS_RSTREGARSTREG_INVERTED = 1'b0, IS_RSTREGB_INVERTED = 1'b0;
    parameter [17:0] INIT_A = 0, INIT_B = 0, SRVAL_A = 0, SRVAL_B = 0;
    parameter [255:0]
        INIT_00 = 0, INIT_01 = 0, INIT_02 = 0, INIT_03 = 0, INIT_04 = 0, INIT_05 = 0, INIT_06 = 0, INIT_07 = 0,
        INIT_08 = 0, INIT_09 = 0, INIT_0A = 0, INIT_0B = 0, INIT_0C = 0, INIT_0D = 0, INIT_0E = 0, INIT_0F = 0,
        INIT_10 = 0, INIT_11 = 0, INIT_12 = 0, INIT_13 = 0, INIT_14 = 0, INIT_15 = 0, INIT_16 = 0, INIT_17 = 0,
        INIT_18 = 0, INIT_19 = 0, INIT_1A = 0, INIT_1B = 0, INIT_1C = 0, INIT_1D = 0, INIT_1E = 0, INIT_1F = 0,
        INIT_20 = 0, INIT_21 = 0, INIT_22 = 0, INIT_23 = 0, INIT_24 = 0, INIT_25 = 0, INIT_26 = 0, INIT_27 = 0,
        INIT_28 = 0, INIT_29 = 0, INIT_2A = 0, INIT_2B = 0, INIT_2C = 0, INIT_2D = 0, INIT_2E = 0, INIT_2F = 0,
        INIT_30 = 0, INIT_31 = 0, INIT_32 = 0, INIT_33 = 0, INIT_34 = 0, INIT_35 = 0, INIT_36 = 0, INIT_37 = 0,
        INIT_38 = 0, INIT_39 = 0, INIT_3A = 0, INIT_3B = 0, INIT_3C = 0, INIT_3D = 0, INIT_3E = 0, INIT_3F = 0;
    parameter [255:0]
        INITP_00 = 0, INITP_01 = 0, INITP_02 = 0, INITP_03 = 0, INITP_04 = 0, INITP_05 = 0, INITP_06 = 0, INITP_07 = 0;

    initial
        if (DOA_REG != 0 || DOB_REG != 0 || RAM_EXTENSION_A != "NONE" || RAM_EXTENSION_B != "NONE" || EN_ECC_READ != "FALSE")
            $fatal(1, "RAMB18E1: registers at its outputs, cascades and ECC are not modelled");

    greygate_block_ram #(
        .DATA(16), .SDP(RAM_MODE == "SDP"), .WRITE_MODE_A(WRITE_MODE_A), .WRITE_MODE_B(WRITE_MODE_B),
        .READ_WIDTH_A(READ_WIDTH_A), .READ_WIDTH_B(READ_WIDTH_B), .WRITE_WIDTH_A(WRITE_WIDTH_A), .WRITE_WIDTH_B(WRITE_WIDTH_B),
        .INIT_A(INIT_A), .INIT_B(INIT_B), .SRVAL_A(SRVAL_A), .SRVAL_B(SRVAL_B),
        .INIT({
            INIT_3F, INIT_3E, INIT_3D, INIT_3C, INIT_3B, INIT_3A, INIT_39, INIT_38,
            INIT_37, INIT_36, INIT_35, INIT_34, INIT_33, INIT_32, INIT_31, INIT_30,
            INIT_2F, INIT_2E, INIT_2D, INIT_2C, INIT_2B, INIT_2A, INIT_29, INIT_28,
            INIT_27, INIT_26, INIT_25, INIT_24, INIT_23, INIT_22, INIT_21, INIT_20,
            INIT_1F, INIT_1E, INIT_1D, INIT_1C, INIT_1B, INIT_1A, INIT_19, INIT_18,
            INIT_17, INIT_16, INIT_15, INIT_14, INIT_13, INIT_12, INIT_11, INIT_10,
            INIT_0F, INIT_0E, INIT_0D, INIT_0C, INIT_0B, INIT_0A, INIT_09, INIT_08,
            INIT_07, INIT_06, INIT_05, INIT_04, INIT_03, INIT_02, INIT_01, INIT_00
        }),
        .INITP({
            INITP_07, INITP_06, INITP_05, INITP_04, INITP_03, INITP_02, INITP_01, INITP_00
        })
    ) ram (
        .DOADO(DOADO), .DOBDO(DOBDO), .DOPADOP(DOPADOP), .DOPBDOP(DOPBDOP), .WEA(WEA), .WEBWE(WEBWE),
        .DIADI(DIADI), .DIBDI(DIBDI), .DIPADIP(DIPADIP), .DIPBDIP(DIPBDIP),
        .at_a(ADDRARDADDR[13:0]), .at_b(ADDRBWRADDR[13:0]),
        .clk_a(CLKARDCLK ^ IS_CLKARDCLK_INVERTED), .clk_b(CLKBWRCLK ^ IS_CLKBWRCLK_INVERTED),
        .en_a(ENARDEN ^ IS_ENARDEN_INVERTED), .en_b(ENBWREN ^ IS_ENBWREN_INVERTED),
        .rst_a(RSTRAMARSTRAM ^ IS_RSTRAMARSTRAM_INVERTED), .rst_b(RSTRAMB ^ IS_RSTRAMB_INVERTED)
    );
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
    parameter integer DOA_REG = 0, DOB_REG = 0;
    parameter integer READ_WIDTH_A = 0, READ_WIDTH_B = 0, WRITE_WIDTH_A = 0, WRITE_WIDTH_B = 0;
    parameter WRITE_MODE_A = "WRITE_FIRST", WRITE_MODE_B = "WRITE_FIRST";
    parameter RAM_MODE = "TDP", RAM_EXTENSION_A = "NONE", RAM_EXTENSION_B = "NONE";
    parameter EN_ECC_READ = "FALSE", EN_ECC_WRITE = "FALSE";
    parameter INIT_FILE = "NONE", SIM_COLLISION_CHECK = "ALL", SIM_DEVICE = "7SERIES";
    parameter RDADDR_COLLISION_HWCONFIG = "DELAYED_WRITE", RSTREG_PRIORITY_A = "RSTREG", RSTREG_PRIORITY_B = "RSTREG";
    parameter IS_CLKARDCLK_INVERTED = 1'b0, IS_CLKBWRCLK_INVERTED = 1'b0, IS_ENARDEN_INVERTED = 1'b0;
    parameter IS_ENBWREN_INVERTED = 1'b0, IS_RSTRAMARSTRAM_INVERTED = 1'b0, IS_RSTRAMB_INVERTED = 1'b0;
    parameter IS_RSTREGARSTREG_INVERTED = 1'b0, IS_RSTREGB_INVERTED = 1'b0;
    parameter [35:0] INIT_A = 0, INIT_B = 0, SRVAL_A = 0, SRVAL_B = 0;
    parameter [255:0]
        INIT_00 = 0, INIT_01 = 0, INIT_02 = 0, INIT_03 = 0, INIT_04 = 0, INIT_05 = 0, INIT_06 = 0, INIT_07 = 0,
        INIT_08 = 0, INIT_09 = 0, INIT_0A = 0, INIT_0B = 0, INIT_0C = 0, INIT_0D = 0, INIT_0E = 0, INIT_0F = 0,
        INIT_10 = 0, INIT_11 = 0, INIT_12 = 0, INIT_13 = 0, INIT_14 = 0, INIT_15 = 0, INIT_16 = 0, INIT_17 = 0,
        INIT_18 = 0, INIT_19 = 0, INIT_1A = 0, INIT_1B = 0, INIT_1C = 0, INIT_1D = 0, INIT_1E = 0, INIT_1F = 0,
        INIT_20 = 0, INIT_21 = 0, INIT_22 = 0, INIT_23 = 0, INIT_24 = 0, INIT_25 = 0, INIT_26 = 0, INIT_27 = 0,
        INIT_28 = 0, INIT_29 = 0, INIT_2A = 0, INIT_2B = 0, INIT_2C = 0, INIT_2D = 0, INIT_2E = 0, INIT_2F = 0,
        INIT_30 = 0, INIT_31 = 0, INIT_32 = 0, INIT_33 = 0, INIT_34 = 0, INIT_35 = 0, INIT_36 = 0, INIT_37 = 0,
        INIT_38 = 0, INIT_39 = 0, INIT_3A = 0, INIT_3B = 0, INIT_3C = 0, INIT_3D = 0, INIT_3E = 0, INIT_3F = 0,
        INIT_40 = 0, INIT_41 = 0, INIT_42 = 0, INIT_43 = 0, INIT_44 = 0, INIT_45 = 0, INIT_46 = 0, INIT_47 = 0,
        INIT_48 = 0, INIT_49 = 0, INIT_4A = 0, INIT_4B = 0, INIT_4C = 0, INIT_4D = 0, INIT_4E = 0, INIT_4F = 0,
        INIT_50 = 0, INIT_51 = 0, INIT_52 = 0, INIT_53 = 0, INIT_54 = 0, INIT_55 = 0, INIT_56 = 0, INIT_57 = 0,
        INIT_58 = 0, INIT_59 = 0, INIT_5A = 0, INIT_5B = 0, INIT_5C = 0, INIT_5D = 0, INIT_5E = 0, INIT_5F = 0,
        INIT_60 = 0, INIT_61 = 0, INIT_62 = 0, INIT_63 = 0, INIT_64 = 0, INIT_65 = 0, INIT_66 = 0, INIT_67 = 0,
        INIT_68 = 0, INIT_69 = 0, INIT_6A = 0, INIT_6B = 0, INIT_6C = 0, INIT_6D = 0, INIT_6E = 0, INIT_6F = 0,
        INIT_70 = 0, INIT_71 = 0, INIT_72 = 0, INIT_73 = 0, INIT_74 = 0, INIT_75 = 0, INIT_76 = 0, INIT_77 = 0,
        INIT_78 = 0, INIT_79 = 0, INIT_7A = 0, INIT_7B = 0, INIT_7C = 0, INIT_7D = 0, INIT_7E = 0, INIT_7F = 0;
    parameter [255:0]
        INITP_00 = 0, INITP_01 = 0, INITP_02 = 0, INITP_03 = 0, INITP_04 = 0, INITP_05 = 0, INITP_06 = 0, INITP_07 = 0,
        INITP_08 = 0, INITP_09 = 0, INITP_0A = 0, INITP_0B = 0, INITP_0C = 0, INITP_0D = 0, INITP_0E = 0, INITP_0F = 0;

    initial
        if (DOA_REG != 0 || DOB_REG != 0 || RAM_EXTENSION_A != "NONE" || RAM_EXTENSION_B != "NONE" || EN_ECC_READ != "FALSE")
            $fatal(1, "RAMB36E1: registers at its outputs, cascades and ECC are not modelled");

    greygate_block_ram #(
        .DATA(32), .SDP(RAM_MODE == "SDP"), .WRITE_MODE_A(WRITE_MODE_A), .WRITE_MODE_B(WRITE_MODE_B),
        .READ_WIDTH_A(READ_WIDTH_A), .READ_WIDTH_B(READ_WIDTH_B), .WRITE_WIDTH_A(WRITE_WIDTH_A), .WRITE_WIDTH_B(WRITE_WIDTH_B),
        .INIT_A(INIT_A), .INIT_B(INIT_B), .SRVAL_A(SRVAL_A), .SRVAL_B(SRVAL_B),
        .INIT({
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
        }),
        .INITP({
            INITP_0F, INITP_0E, INITP_0D, INITP_0C, INITP_0B, INITP_0A, INITP_09, INITP_08,
            INITP_07, INITP_06, INITP_05, INITP_04, INITP_03, INITP_02, INITP_01, INITP_00
        })
    ) ram (
        .DOADO(DOADO), .DOBDO(DOBDO), .DOPADOP(DOPADOP), .DOPBDOP(DOPBDOP), .WEA(WEA), .WEBWE(WEBWE),
        .DIADI(DIADI), .DIBDI(DIBDI), .DIPADIP(DIPADIP), .DIPBDIP(DIPBDIP),
        .at_a(ADDRARDADDR[14:0]), .at_b(ADDRBWRADDR[14:0]),
        .clk_a(CLKARDCLK ^ IS_CLKARDCLK_INVERTED), .clk_b(CLKBWRCLK ^ IS_CLKBWRCLK_INVERTED),
        .en_a(ENARDEN ^ IS_ENARDEN_INVERTED), .en_b(ENBWREN ^ IS_ENBWREN_INVERTED),
        .rst_a(RSTRAMARSTRAM ^ IS_RSTRAMARSTRAM_INVERTED), .rst_b(RSTRAMB ^ IS_RSTRAMB_INVERTED)
    );
endmodule
