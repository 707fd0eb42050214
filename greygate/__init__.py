"""Grey-box networks from a mechanical plant to an FPGA."""

__version__ = "0.1.0"
