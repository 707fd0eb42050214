"""The ranges of numbers on the command line, which are checked before a command begins.

Each range is the callback of a `typer.Option`; it raises InputError naming the option, its value and what to give.
"""

import math
import sys
from collections.abc import Callable

import typer

from greygate import limits
from greygate.compiler.targets import FACTORS, MULTIPLIERS
from greygate.errors import InputError
from greygate.limits import NARROWEST, WIDEST

MOST = 10**9  # of samples, epochs and lags: more takes longer than anybody waits
LEAST, GREATEST = math.ulp(0.0), sys.float_info.max  # above 0, below infinity
SEEDS = 2**31  # Verilator takes seeds below this


def _within(low: float, high: float, wish: str) -> Callable:
    def check(param: typer.CallbackParam, value: float | None) -> float | None:
        if value is not None and not low <= value <= high:  # nan is in no range
            raise InputError(f"{param.opts[-1]} {value}: give {wish}")
        return value

    return check


COUNT = _within(1, MOST, f"a whole number from 1 to {MOST}")
SAMPLES = _within(0, MOST, f"a whole number of samples from 0 to {MOST}")
SEED = _within(0, SEEDS - 1, f"a whole number from 0 to {SEEDS - 1}")
JOBS = _within(1, 1024, "a whole number from 1 to 1024")
ORDER = _within(1, 20, "a whole number from 1 to 20")
STARTS = _within(1, 1000, "a whole number of starts from 1 to 1000")
WIDTH = _within(NARROWEST, WIDEST, f"{NARROWEST} to {WIDEST} bits")
FINER = _within(0, limits.FINER, f"0 to {limits.FINER} bits; with the width they make at most {WIDEST}")
MACS = _within(MULTIPLIERS[0], MULTIPLIERS[-1], f"{MULTIPLIERS[0]} to {MULTIPLIERS[-1]} multipliers")
FACTOR = _within(FACTORS[0], FACTORS[-1], f"{FACTORS[0]} to {FACTORS[-1]} bits")
LUTS = _within(1, MOST, "a whole number of LUTs of at least 1")
DSPS = _within(0, MOST, "a whole number of DSPs of at least 0")
MEMORIES = _within(0, MOST, "a number of blocks of memory of at least 0")
SHARE = _within(0, math.nextafter(1, 0), "a share of at least 0 and below 1")
DECAY = _within(0, GREATEST, "a finite number, 0 or more")
MHZ = _within(1e-3, 1e4, "a clock rate in MHz from 0.001 to 10000")
SECONDS = _within(LEAST, math.inf, "seconds above 0")
GROWTH = _within(math.nextafter(1, 2), GREATEST, "a factor above 1 on the error of float, e.g. 1.05")
ALLOWANCE = _within(1, GREATEST, "a factor of at least 1 on the error before pruning, e.g. 1.02")
MEGAHERTZ = _within(1, 1000, "1 to 1000 MHz")
BAUD = _within(300, 12_000_000, "300 to 12000000 baud")
