"""Seconds from a trained network to Verilog on disk, imports included: the whole command, median of five."""

import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

COMMAND = [str(Path(sys.executable).with_name("greygate")), "compile", "valve_cylinder", "--out"]


def main() -> None:
    seconds = []
    with tempfile.TemporaryDirectory() as folder:
        for i in range(6):
            began = time.perf_counter()
            subprocess.run([*COMMAND, f"{folder}/{i}"], check=True, capture_output=True)
            seconds.append(time.perf_counter() - began)
    warm = seconds[1:]  # the first run may fill numba's cache
    print(f"compile valve_cylinder: {statistics.median(warm):.2f} s (first {seconds[0]:.2f} s)")


if __name__ == "__main__":
    main()
