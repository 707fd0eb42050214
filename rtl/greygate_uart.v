// SPDX-License-Identifier: MIT
// UART: 8 data bits, lowest first, no parity, one stop bit. It listens or sends, and hands over bits, not bytes.

`default_nettype none

module greygate_uart #(
    parameter CLOCKS = 24  // clocks of a bit
) (
    input  wire clk,
    input  wire rst,
    input  wire rxd,     // asynchronous
    output reg  txd,
    input  wire talk,    // 1 send, 0 listen: obeyed from the next byte on
    input  wire tx_bit,  // the next bit to send
    output wire sent,    // it is taken now
    output wire rx_bit,
    output wire heard,   // rx_bit is a bit received now
    output wire eighth,  // the bit that is taken or received is the last of its byte
    output wire broken   // a byte received without a stop bit
);

    localparam COUNT_W = $clog2(CLOCKS);
    localparam [31:0] LAST_32 = CLOCKS - 1;
    localparam [31:0] HALF_32 = CLOCKS / 2 - 1;
    localparam [3:0] START = 4'd0, EIGHTH = 4'd8, STOP = 4'd9;  // the places of a byte; 1 to 8 are data

    (* ASYNC_REG = "TRUE" *) reg [1:0] synchronised;
    assign rx_bit = synchronised[0];

    reg [COUNT_W-1:0] count;
    reg [3:0] place;
    reg busy, sending;

    wire now = busy && count == {COUNT_W{1'b0}};  // listening: the middle of a bit; sending: its begin
    wire data = place != START && place != STOP;
    assign sent = now && data && sending;
    assign heard = now && data && !sending;
    assign eighth = place == EIGHTH;
    assign broken = now && place == STOP && !sending && !rx_bit;

    always @(posedge clk) begin
        synchronised <= {rxd, synchronised[1]};
        count <= now || (!busy && talk) ? LAST_32[COUNT_W-1:0]
            : !busy ? HALF_32[COUNT_W-1:0] : count - {{COUNT_W - 1{1'b0}}, 1'b1};
        if (!busy) begin
            busy <= talk || !rx_bit;
            sending <= talk;
        end else if (now) begin
            place <= place == STOP ? START : place + 4'd1;
            if (sending) txd <= place == STOP || (data && tx_bit);
            if (place == STOP || (place == START && !sending && rx_bit)) begin
                busy <= sending && talk;
                place <= START;
            end
        end
        if (rst) begin
            synchronised <= 2'b11;
            busy <= 1'b0;
            sending <= 1'b0;
            place <= START;
            txd <= 1'b1;
        end
    end

    generate
        if (CLOCKS < 4) begin : check
            greygate_uart_parameters_are_illegal illegal ();
        end
    endgenerate

endmodule

`default_nettype wire
