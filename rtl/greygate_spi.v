// SPDX-License-Identifier: MIT
// SPI slave, mode 0, sampled by the clock: sck at most a sixth of it. It listens or sends, and hands over bits.
// Each byte goes lowest bit first. While there is nothing to send, miso is high.

`default_nettype none

module greygate_spi (
    input  wire clk,
    input  wire rst,
    input  wire sck,     // asynchronous, as are the next two
    input  wire cs_n,    // low during a transfer of whole bytes
    input  wire mosi,
    output reg  miso,
    input  wire talk,    // 1 send, 0 listen: obeyed from the next byte on
    input  wire tx_bit,  // the next bit to send
    output wire sent,    // it is taken now
    output wire rx_bit,
    output wire heard,   // rx_bit is a bit received now
    output wire eighth,  // the bit that is taken or received is the last of its byte
    output wire broken   // a transfer has ended
);

    (* ASYNC_REG = "TRUE" *) reg [2:0] clocks;
    (* ASYNC_REG = "TRUE" *) reg [1:0] selects, data;
    reg [2:0] place;  // of the bit in its byte
    reg sending;

    wire rise = clocks[1] && !clocks[0] && !selects[0];
    assign rx_bit = data[0];
    assign sent = rise && sending;
    assign heard = rise && !sending;
    assign eighth = place == 3'd7;
    assign broken = selects[0];

    always @(posedge clk) begin
        clocks <= {sck, clocks[2:1]};
        selects <= {cs_n, selects[1]};
        data <= {mosi, data[1]};
        if (selects[0]) place <= 3'd0;
        else if (rise) place <= place + 3'd1;
        if (!clocks[1]) begin  // between two bits
            if (place == 3'd0) sending <= talk;
            miso <= !sending || tx_bit;
        end
        if (rst) begin
            clocks <= 3'b000;
            selects <= 2'b11;
            sending <= 1'b0;
            miso <= 1'b1;
        end
    end

endmodule

`default_nettype wire
