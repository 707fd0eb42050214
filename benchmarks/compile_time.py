"""Seconds from a trained network to Verilog on disk, imports included: the whole command, median of five."""

import statistics
import subprocess

from .shared import GREYGATE, scratch, taken

TAKES = "a minute"
THREADS = "all"


def main() -> None:
    with scratch() as folder:
        command, names = [GREYGATE, "compile", "valve_cylinder", "--out"], iter("abcdef")

        def run() -> None:
            subprocess.run([*command, folder / next(names)], check=True, capture_output=True)

        first, *warm = taken(run, 6)
    print(f"compile valve_cylinder: {statistics.median(warm):.2f} s (first {first:.2f} s)")  # it may fill numba's cache
