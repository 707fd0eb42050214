"""Networks of other tools: the largest difference over a free run, and the bits of the hardware made of them.

Exit code 1 if a bit differs, or an answer by more than 1e-6 of its range.
"""

from pathlib import Path

import numpy as np
from imported_models import ALL, free_run, signal

from greygate.hardware.build import Project
from greygate.machines.source import Source
from greygate.models.training.record import Record
from greygate.plants.recording import Recording
from greygate.project import compile_project, fixed_and_float, verify_project

from .made import keep
from .shared import VERILATOR, scratch

TAKES = "three minutes"
NEEDS = VERILATOR

STEPS = 1000
AGREED = 1e-6


def measured(case, folder: Path) -> dict:
    network, answer = case.make(folder)
    x = signal(STEPS, len(network.inputs))
    y, expected = free_run(network, x), answer(x)
    columns = {p.name: x[:, k] for k, p in enumerate(network.inputs)}
    columns |= {p.name: y[:, k] for k, p in enumerate(network.outputs)}
    units = {p.name: p.unit for p in (*network.inputs, *network.outputs)}
    Recording(1e-3, columns, units).write_csv(folder / "run.csv")
    network.save(folder / "imported")
    source = Source(str(folder / "imported.toml"), {"run": str(folder / "run.csv")})
    compiled = compile_project(source, folder / "build", source.formats(16), architectures=("folded",))
    verified = verify_project(Project.open(folder / "build"), seed=1)
    record = Record(*({p.name: columns[p.name] for p in ports} for ports in (network.inputs, network.outputs)))
    errors = fixed_and_float(compiled, record)
    bits = [v.mismatch for found in verified.values() for v in found.verdicts]
    return {
        "source": case.source,
        "model": case.model,
        "operations": case.operations,
        "parameters": int(sum(v.size for v in network.parameters().values())),
        "largest": float(np.abs(y - expected).max() / np.ptp(expected)),
        "fixed": max(e["fixed"] / float(np.ptp(columns[name])) for name, e in errors.items()),
        "differing": None if any(bits) else 0,
    }


def main() -> int:
    rows = []
    for case in ALL:
        with scratch() as folder:
            rows.append(measured(case, folder))
        print(rows[-1], flush=True)
    keep("importers", "models", {"steps": STEPS, "rows": rows})
    return int(any(row["differing"] != 0 or row["largest"] > AGREED for row in rows))
