"""The compiler: from a float network to the integer program (pipeline), and from that to Verilog (emit)."""
