// SPDX-License-Identifier: MIT
// Stream: the AXI4-Stream edge of a core that works on one sample at a time.
// Takes a beat, raises start, waits for done, gives a beat. A reset drops a sample under way.
// The next beat may come before a result is taken; its step begins in the clock in which that is.

`default_nettype none

module greygate_stream #(
    parameter IN_W = 16,  // width of a sample, whole bytes
    parameter OUT_W = 16  // width of a result, whole bytes
) (
    input  wire             clk,
    input  wire             rst,            // synchronous, active high
    input  wire [ IN_W-1:0] s_axis_tdata,
    input  wire             s_axis_tvalid,
    output wire             s_axis_tready,
    output reg  [OUT_W-1:0] m_axis_tdata,
    output reg              m_axis_tvalid,
    input  wire             m_axis_tready,
    input  wire             ready,          // the core may begin a step
    output reg  [ IN_W-1:0] sample,         // holds still from start to done
    output reg              start,          // the core begins now
    input  wire             done,           // the result stands now
    input  wire [OUT_W-1:0] result
);

    reg busy_reg;

    wire taken = m_axis_tvalid && m_axis_tready;
    wire idle = ready && (!busy_reg || taken);
    wire valid;
    wire [IN_W-1:0] beat;

    greygate_skid #(
        .W(IN_W)
    ) skid (
        .clk(clk),
        .rst(rst),
        .s_axis_tdata(s_axis_tdata),
        .s_axis_tvalid(s_axis_tvalid),
        .s_axis_tready(s_axis_tready),
        .beat(beat),
        .valid(valid),
        .take(idle)
    );

    always @(posedge clk) begin
        start <= valid && idle;
        if (done) begin
            m_axis_tdata <= result;
            m_axis_tvalid <= 1'b1;
        end
        if (taken) begin
            m_axis_tvalid <= 1'b0;
            busy_reg <= 1'b0;
        end
        if (valid && idle) begin
            sample <= beat;
            busy_reg <= 1'b1;
        end
        if (rst) begin
            start <= 1'b0;
            busy_reg <= 1'b0;
            m_axis_tvalid <= 1'b0;
        end
    end

    generate
        if (IN_W < 8 || OUT_W < 8 || IN_W % 8 != 0 || OUT_W % 8 != 0) begin : check
            greygate_stream_parameters_are_illegal illegal ();
        end
    endgenerate

endmodule

`default_nettype wire
