"""What the command line and a build may say of the hardware. Every start reads this file, so it imports nothing."""

ARCHITECTURES = ("parallel", "folded")  # of the emitted Verilog
FAMILIES = ("ecp5", "ice40", "xilinx")  # of FPGA, for synthesis
NARROWEST, WIDEST = 4, 32  # bits of a word
FINER = WIDEST - NARROWEST  # bits that weights and neurons may have beyond the word
MACS = 256  # multipliers of the folded architecture
