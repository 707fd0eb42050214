"""The flow network as Verilog of da4ml or alkaid. Run by flow_designs.py, elsewhere.

Usage: python flow_peers.py PACKAGE DATA.npz WIDTH INDEX    writes flow/, prints {"rms": ..., "files": [...]}
DATA: as of accuracy_peers.py. WIDTH: bits of weights, inputs and results. INDEX: bits of the argument of a table.
"""

import json
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
from accuracy_peers import PACKAGES, network

CUTOFF = 5  # of the peers' measure of depth, between two registers


def main() -> None:
    package, path, width, index = sys.argv[1], sys.argv[2], *map(int, sys.argv[3:])
    array, trace = (getattr(import_module(module), name) for module, name in PACKAGES[package])
    data = dict(np.load(path))
    made = network(array, trace, data, width, index)
    lsb = 2.0 ** (1 - width)
    x = np.clip(np.floor(data["x"] / lsb + 0.5) * lsb, -1, 1 - lsb)
    y = np.asarray(made.predict(x)).reshape(-1)
    model = import_module(f"{package}.codegen.rtl.rtl_model").RTLModel
    model(made, prj_name="flow", path="flow", latency_cutoff=CUTOFF, print_latency=False).write()
    files = sorted(str(f) for f in Path("flow/src").rglob("*.v") if "wrapper" not in f.name)
    print(json.dumps({"rms": float(np.sqrt(np.mean((y - data["y"]) ** 2))), "files": files}))


if __name__ == "__main__":
    main()
