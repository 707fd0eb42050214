// SPDX-License-Identifier: MIT
// Skid: the entry of a stream, which holds the beat that the core cannot take yet.
// s_axis_tready comes from a register, so that no path leads through it from who takes the results to who gives samples.

`default_nettype none

module greygate_skid #(
    parameter W = 16  // width of a beat
) (
    input  wire         clk,
    input  wire         rst,            // synchronous, active high: drops the beat
    input  wire [W-1:0] s_axis_tdata,
    input  wire         s_axis_tvalid,
    output wire         s_axis_tready,
    output wire [W-1:0] beat,
    output wire         valid,          // a beat is there
    input  wire         take            // the core takes it now, if it is there
);

    reg full;
    reg [W-1:0] held;

    assign s_axis_tready = !full && !rst;
    assign beat = full ? held : s_axis_tdata;
    assign valid = full || s_axis_tvalid;

    always @(posedge clk) begin
        if (!full) held <= s_axis_tdata;
        full <= !rst && valid && !take;
    end

    generate
        if (W < 1) begin : check
            greygate_skid_parameters_are_illegal illegal ();
        end
    endgenerate

endmodule

`default_nettype wire
