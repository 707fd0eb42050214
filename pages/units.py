"""How the pages write figures and units: "1.23", "8.40·10⁻⁷", "bar", "µm"; a dash where there is no figure."""

import math
from collections.abc import Sequence

NONE = "–"
MEASURED = {
    "clock_mhz": "clock [MHz]",
    "us_per_step": "a step [µs]",
    "clocks": "clocks a step",
    "stopped_after_s": "stopped after [s]",
}
"""Figures of synthesis that have a unit, or are for a step -> their heading."""


def number(value: float | None, digits: int = 3) -> str:
    """Format a figure with three significant digits, and with a power of ten if it is very small or large."""
    if value is None:
        return NONE
    if value == 0:
        return "0"
    power = math.floor(math.log10(abs(value)))
    if -4 < power < 6:
        text = f"{value:.{max(digits - 1 - power, 0)}f}"
    else:
        mantissa, exponent = f"{value:.{digits - 1}e}".split("e")
        text = f"{mantissa}·10{str(int(exponent)).translate(str.maketrans('-0123456789', '⁻⁰¹²³⁴⁵⁶⁷⁸⁹'))}"
    return text.replace("-", "−")


def figure(value: float | str | None) -> str:
    """Format a cell of a table: a figure of any kind."""
    if isinstance(value, str):
        return value
    return f"{value:,.0f}" if value is not None and value == int(value) else number(value, 4)


def heading(name: str) -> str:
    """The heading of a figure of synthesis: what is counted, or what is measured with its unit."""
    return MEASURED.get(name, name.replace("_", " "))


def per_cent(value: float | None) -> str:
    """Format per cent with one decimal, without the sign %."""
    return NONE if value is None or not math.isfinite(value) else f"{value:.1f}".replace("-", "−")


def display(unit: str, reach: float = 0.0) -> tuple[float, str]:
    """(factor, label) from SI to a person's unit: bar for Pa; for m µm, or mm if `reach` is 1 mm or more."""
    if unit == "Pa":
        return 1e-5, "bar"
    if unit == "m":
        return (1e3, "mm") if reach >= 1e-3 else (1e6, "µm")
    return 1.0, "" if unit == "1" else unit


def shown(value: float | Sequence[float] | None, unit: str, reach: float = 0.0) -> str:
    """Format an SI figure, or a pair of them, in the unit of `display`, without writing the unit."""
    if isinstance(value, Sequence):
        return " to ".join(shown(v, unit, reach) for v in value)
    return number(None if value is None else value * display(unit, reach)[0])


def labelled(name: str, unit: str) -> str:
    """The label of an axis: "p_a [bar]", or only the name if there is no unit."""
    return f"{name} [{unit}]" if unit else name


def differing(bits: int | None) -> str:
    """Say how many bits differ; None means that some do, in an unknown number."""
    return "bits differ" if bits is None else f"{bits:,} bits differ"
