// SPDX-License-Identifier: MIT
// Frame: a core behind a line of bits. A request brings one sample, the answer its result; docs/board.md, "Frames".
//
// One shift register holds the sample while it comes in, and the result while it goes out. A sample is stepped only if
// its check sum is right and its number is the next one. The result stays with the core until the next sample, so that
// it can be asked for again.

`default_nettype none

module greygate_frame #(
    parameter IN_W = 16,    // width of a sample, whole bytes
    parameter OUT_W = 16,   // width of a result, whole bytes
    parameter [15:0] SEED = 16'hffff,  // of the check sums: it tells one network from another
    parameter TICK = 0      // clocks between two steps; 0: a step begins when its sample has come
) (
    input  wire clk,
    input  wire rst,

    // bits of the line
    output wire talk,
    output wire tx_bit,
    input  wire sent,
    input  wire rx_bit,
    input  wire heard,
    input  wire eighth,
    input  wire broken,

    // the core
    output reg              core_rst,
    output wire [ IN_W-1:0] sample_tdata,
    output wire             sample_tvalid,
    input  wire             sample_tready,
    input  wire [OUT_W-1:0] result_tdata,
    input  wire             result_tvalid,
    output wire             result_tready,

    // flags
    input  wire limited,  // the result stands at an end of its format
    output wire step,     // a step begins
    output reg  overrun,  // a tick found no sample; until the next answer
    output reg  refused   // the last request was not stepped
);

    localparam W = (IN_W > OUT_W ? IN_W : OUT_W) + 8;
    localparam BYTES_W = $clog2(W / 8 + 4);
    localparam [31:0] REQUEST_32 = IN_W / 8 + 2;  // the bytes after SYNC, less one: tag, sample, check sum
    localparam [31:0] ANSWER_32 = OUT_W / 8 + 3;  // with SYNC, less one
    localparam [7:0] SYNC = 8'h55;
    localparam [3:0] HUNT = 4'd0, BODY = 4'd1, JUDGE = 4'd2, WAIT = 4'd3, TAKE = 4'd4, GIVE = 4'd5, STEP = 4'd6,
        HEAD = 4'd7, ANSWER = 4'd8;

    reg [3:0] state;
    reg [W-1:0] word;
    reg [BYTES_W-1:0] bytes;  // still to come after this one
    reg [4:0] next;           // number of the next sample, modulo 32

    wire listening = state == HUNT || state == BODY;
    wire check = bytes[BYTES_W-1:1] == {BYTES_W - 1{1'b0}};  // these two bytes are the check sum
    wire end_of_byte = (listening ? heard : sent) && eighth;
    wire end_of_frame = end_of_byte && bytes == {BYTES_W{1'b0}};

    // tag of a request: {restart, 2 zeros, number}; that of an answer: {limited, overrun, refused, next}
    wire [7:0] tag = word[W-IN_W-8+:8];
    assign sample_tdata = word[W-1-:IN_W];

    wire [15:0] crc;
    greygate_crc #(
        .SEED(SEED)
    ) check_sum (
        .clk(clk),
        .restart(state == HUNT || state == HEAD),
        .en(state == BODY ? heard : state == ANSWER && sent),
        .bit_in(state == BODY ? rx_bit : tx_bit),
        .crc(crc)
    );

    assign talk = state == HEAD || state == ANSWER;
    assign tx_bit = check && state == ANSWER ? crc[0] : word[0];

    wire right = crc == 16'd0 && tag[6:5] == 2'd0 && (tag[7] || (!core_rst && tag[4:0] == next));
    assign result_tready = state == TAKE;
    assign sample_tvalid = state == GIVE;
    assign step = sample_tvalid && sample_tready;

    wire tick;
    always @(posedge clk) begin
        case (state)
            HUNT: if (end_of_byte && {rx_bit, word[W-1-:7]} == SYNC) state <= BODY;
            BODY: if (broken) state <= HUNT;
                else if (end_of_frame) state <= JUDGE;
            JUDGE: begin
                state <= right ? (TICK > 0 ? WAIT : TAKE) : HEAD;
                refused <= !right;
                if (right) next <= tag[4:0] + 5'd1;
                if (right && tag[7]) core_rst <= 1'b1;
            end
            WAIT: if (tick) state <= TAKE;
            TAKE: begin
                state <= GIVE;
                core_rst <= 1'b0;
            end
            GIVE: if (sample_tready) state <= STEP;
            STEP: if (result_tvalid) state <= HEAD;
            HEAD: if (end_of_byte) state <= ANSWER;
            default: if (end_of_frame) state <= HUNT;
        endcase

        if (state == HUNT) bytes <= REQUEST_32[BYTES_W-1:0];
        else if (!listening && !talk) bytes <= ANSWER_32[BYTES_W-1:0];
        else if (end_of_byte) bytes <= bytes - {{BYTES_W - 1{1'b0}}, 1'b1};

        if (listening ? heard && !(state == BODY && check) : sent) word <= {rx_bit, word[W-1:1]};
        if (state == JUDGE ? !right : state == STEP) word[7:0] <= SYNC;
        if (state == HEAD && end_of_byte) word[OUT_W+7:0] <= {result_tdata, limited, overrun, refused, next};

        if (tick && state != WAIT && !core_rst) overrun <= 1'b1;
        else if (state == HEAD && end_of_byte) overrun <= 1'b0;

        if (rst) begin
            state <= HUNT;
            core_rst <= 1'b1;
            overrun <= 1'b0;
            refused <= 1'b0;
            next <= 5'd0;
        end
    end

    generate
        if (TICK > 0) begin : ticks
            localparam TICK_W = $clog2(TICK) + 1;
            localparam [31:0] LAST_32 = TICK - 1;
            reg [TICK_W-1:0] count;
            assign tick = count == {TICK_W{1'b0}};
            always @(posedge clk) count <= rst || tick ? LAST_32[TICK_W-1:0] : count - {{TICK_W - 1{1'b0}}, 1'b1};
        end else begin : no_ticks
            assign tick = 1'b0;
        end
        if (IN_W < 8 || OUT_W < 8 || IN_W % 8 != 0 || OUT_W % 8 != 0 || TICK < 0) begin : illegal
            greygate_frame_parameters_are_illegal illegal ();
        end
    endgenerate

endmodule

`default_nettype wire
