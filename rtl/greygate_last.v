// SPDX-License-Identifier: MIT
// Last: the tlast of each sample, kept until its result leaves.

`default_nettype none

module greygate_last #(
    parameter DEPTH = 64  // the most samples that have no result yet
) (
    input  wire clk,
    input  wire rst,    // synchronous
    input  wire give,   // a sample enters, its tlast is `given`
    input  wire given,
    output wire room,   // one more may enter
    input  wire take,   // a result leaves, its tlast is `taken`
    output wire taken
);

    localparam COUNT_W = $clog2(DEPTH + 1);
    localparam [31:0] DEPTH_32 = DEPTH;
    localparam [COUNT_W-1:0] ONE = {{COUNT_W - 1{1'b0}}, 1'b1};

    reg [DEPTH:0] lasts;  // the newest at 1
    reg [COUNT_W-1:0] count;

    assign room = count != DEPTH_32[COUNT_W-1:0];
    assign taken = lasts[count];

    always @(posedge clk) begin
        if (give) lasts <= {lasts[DEPTH-1:1], given, 1'b0};
        if (rst) count <= {COUNT_W{1'b0}};
        else if (give != take) count <= give ? count + ONE : count - ONE;
    end

    generate
        if (DEPTH < 2) begin : check
            greygate_last_parameters_are_illegal illegal ();
        end
    endgenerate

endmodule

`default_nettype wire
