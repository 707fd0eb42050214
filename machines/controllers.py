"""Tunes and learns the controllers that the package keeps: `python -m greygate.machines.controllers [NAME ...]`."""

import sys

from greygate.machines.catalog import CONTROLLED, task
from greygate.machines.control import make

if __name__ == "__main__":
    for name in sys.argv[1:] or CONTROLLED:
        print(name, file=sys.stderr)
        make(task(name), progress=lambda line: print(line, file=sys.stderr, flush=True))
