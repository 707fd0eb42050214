// SPDX-License-Identifier: MIT
// Serial: a machine of one adder that performs a program of additions and single-bit shifts, one word a clock.
// docs/hardware.md, "The least design"; compiler/serial/writer.py writes its words.
//
// A word is {operation, field}. It acts on the accumulator with the code x, which the word before it has read:
//   0sic  add        acc = (s ? acc >> 1 : acc), its complement if i, + x + c           reads memory[field]
//   1000  write      memory[field] = acc, in the lower half of the fields only          reads memory[field]
//   1001  clear      acc = 0                                                            reads memory[field]
//   1010  rise       acc = 0 if it is negative                                          reads memory[field]
//   1011  look       acc = 0                                                            reads memory[acc]
//   1100  choose     acc = (acc >> 1) + x                                reads memory[field], or the word after it
//   1101  call       begins routine `field`, or ends it; the word after it is performed before, and again after
//   1110  wait       for a sample; or, by the lowest bits of the field, 01 accepts it, 11 pushes acc to the outputs
//   1111  show       holds the result until it is taken, then begins the next step after one more word
// A choice takes the next word for a bit of 1: of the sample, or in a routine the one that was shifted out of acc
// REST_W shifts before, or the sign of acc at the last word that did not shift.

`default_nettype none

module greygate_serial #(
    parameter ACC_W = 24,     // width of the accumulator
    parameter DATA_W = 24,    // width of a word of memory, at most ACC_W
    parameter READ_W = 11,    // width of an address of memory
    parameter FIELD_W = 8,    // width of a field, at most READ_W
    parameter CODE_W = 11,    // width of an address of code
    parameter ENTRY_W = 0,    // width of a routine's number; routines stand at the lowest addresses of code
    parameter COUNT_W = 6,    // width of the place within a routine
    parameter REST_W = 7,     // bits that are kept of those shifted out
    parameter PUSHES = 0,     // whether there are outputs beside acc and x
    parameter BOOT = 128,     // address of code that follows a reset
    parameter START = 256     // address of code at which a step begins
) (
    input  wire               clk,
    input  wire               rst,            // synchronous, active high
    output wire [ CODE_W-1:0] code_address,   // tells the bits of the sample apart, too
    output wire               code_read,
    input  wire [FIELD_W+3:0] word,           // of the code, a clock after its address, kept while code_read is low
    input  wire               sample_bit,
    output wire [ READ_W-1:0] read,
    output wire               write,          // at memory[field]
    input  wire [ DATA_W-1:0] x,              // memory[read] of the clock before
    output wire [ DATA_W-1:0] y,              // what is written, and the last output
    output wire               push,
    input  wire               s_axis_tvalid,
    output wire               s_axis_tready,
    output wire               m_axis_tvalid,
    input  wire               m_axis_tready
);

    wire [3:0] operation = word[FIELD_W+3:FIELD_W];
    wire [FIELD_W-1:0] field = word[FIELD_W-1:0];

    reg [ACC_W-1:0] acc;

    // the code
    reg fresh_reg;  // after a reset: the word was read before it
    reg inside_reg;  // a routine
    reg [CODE_W-1:0] place_reg;
    reg [CODE_W-1:0] back_reg;  // place of the word after the call

    wire flow = operation[3] && operation[2] && !fresh_reg;
    wire call = flow && !operation[1] && operation[0];
    wire wait_word = flow && operation[1] && !operation[0];
    wire show = flow && operation[1] && operation[0];
    wire sleep = (wait_word && !field[0] && !s_axis_tvalid) || (show && !m_axis_tready);
    wire [CODE_W-1:0] next = place_reg - {CODE_W{!call}};  // one more; call shares the logic cell of the sum
    wire [CODE_W-1:0] entry;

    assign code_address = place_reg;
    assign code_read = rst || !sleep;
    assign push = PUSHES != 0 && wait_word && field[1] && field[0];
    assign s_axis_tready = wait_word && !rst && field[0] && !(PUSHES != 0 && field[1]);
    assign m_axis_tvalid = show;

    always @(posedge clk) begin
        fresh_reg <= rst;

        if (rst) inside_reg <= 1'b0;
        else if (call) inside_reg <= !inside_reg;

        if (call) back_reg <= place_reg;

        if (rst) place_reg <= BOOT[CODE_W-1:0];
        else if (show) place_reg <= START[CODE_W-1:0];
        else if (call && !inside_reg) place_reg <= entry;
        else if (!sleep) place_reg <= call ? back_reg : next;
    end

    // the memory
    reg [REST_W-1:0] rest_reg;  // bits shifted out of the accumulator, the oldest lowest; there its sign, too

    wire [REST_W-1:0] rest;  // after a shift
    wire choose = operation == 4'b1100;
    wire chosen = choose && (inside_reg ? rest_reg[0] : sample_bit);
    wire look = operation == 4'b1011;

    assign write = operation == 4'b1000 && !field[FIELD_W-1];
    assign read[0] = look ? acc[0] : field[0] || chosen;

    generate
        genvar k;
        for (k = 1; k < READ_W; k = k + 1) begin : address
            if (k < FIELD_W) begin : low
                assign read[k] = look ? acc[k] : field[k];
            end else begin : high
                assign read[k] = look && acc[k];
            end
        end
    endgenerate

    // the adder
    wire shift = operation[2];
    wire negative = acc[ACC_W-1];
    wire [ACC_W-1:0] shifted = shift ? {negative, acc[ACC_W-1:1]} : acc;
    wire [ACC_W-1:0] augend = operation[1] ? ~shifted : shifted;
    wire [ACC_W-1:0] addend;
    wire [ACC_W-1:0] sum;
    wire unused;

    assign addend[DATA_W-1:0] = x;
    assign {sum, unused} = {augend, 1'b1} + {addend, operation[0]};
    assign y = acc[DATA_W-1:0];

    always @(posedge clk) begin
        if (!operation[3] || choose) acc <= sum;
        else if (operation == 4'b1001 || look || (operation == 4'b1010 && negative)) acc <= {ACC_W{1'b0}};
    end

    always @(posedge clk) rest_reg[0] <= shift ? rest[0] : negative;

    generate
        if (REST_W > 1) begin : keep
            assign rest = {acc[0], rest_reg[REST_W-1:1]};
            always @(posedge clk) if (shift) rest_reg[REST_W-1:1] <= rest[REST_W-1:1];
        end else begin : none
            assign rest = acc[0];
        end
        if (ENTRY_W > 0) begin : several
            assign entry = {{CODE_W - ENTRY_W - COUNT_W{1'b0}}, field[ENTRY_W > 0 ? ENTRY_W - 1 : 0:0], {COUNT_W{1'b0}}};
        end else begin : one
            assign entry = {CODE_W{1'b0}};
        end
        if (ACC_W > DATA_W) begin : extend
            assign addend[ACC_W-1:DATA_W] = {ACC_W - DATA_W{x[DATA_W-1]}};
        end
        if (ACC_W < DATA_W || DATA_W < 2 || FIELD_W < 2 || READ_W < FIELD_W || ENTRY_W + COUNT_W >= CODE_W) begin : check
            greygate_serial_parameters_are_illegal illegal ();
        end
    endgenerate

endmodule

`default_nettype wire
