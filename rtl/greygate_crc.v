// SPDX-License-Identifier: MIT
// CRC: a check sum of 16 bits over a stream of bits, x^16 + x^12 + x^5 + 1, lowest bit of a byte first.
// The check sum leaves bit by bit at crc[0] when it is fed with itself. Over data and check sum it is 0.

`default_nettype none

module greygate_crc #(
    parameter [15:0] SEED = 16'hffff  // where a frame begins; two ends with different seeds understand nothing
) (
    input  wire        clk,
    input  wire        restart,  // a new frame
    input  wire        en,       // a bit of the frame
    input  wire        bit_in,
    output reg  [15:0] crc
);

    wire feedback = crc[0] ^ bit_in;

    always @(posedge clk)
        if (restart) crc <= SEED;
        else if (en) crc <= {1'b0, crc[15:1]} ^ (feedback ? 16'h8408 : 16'h0000);

endmodule

`default_nettype wire
