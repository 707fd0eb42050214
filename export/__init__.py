"""What leaves for other tools: C with physical values, FMUs, sources for FPGA projects."""
