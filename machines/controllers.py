"""Tunes and learns the controllers that are kept in the package: `python -m greygate.machines.controllers [NAME ...]`."""

import sys

from greygate.machines.catalog import CONTROLLED, task
from greygate.machines.control import make

if __name__ == "__main__":
    for name in sys.argv[1:] or CONTROLLED:
        make(task(name), progress=lambda line: print(f"{name}: {line}", file=sys.stderr, flush=True))
