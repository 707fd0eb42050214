"""Grey-box networks from a mechanical plant to an FPGA."""

from greygate.version import __version__ as __version__
