"""PLL settings: the dividers that make one frequency out of another, for each kind of PLL that a board has.

Each function takes the frequency of the oscillator and the one that is wanted, both in MHz, and returns the parameters
of the primitive, which the template `top.v` names, or None if it cannot make that frequency.
"""

from collections.abc import Callable
from itertools import product

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
