"""FMUs of the thesis's machines, of both versions, in fmpy: every output of every step of every scenario, to the bit.

Exit code 1 if an output differs.
"""

from pathlib import Path

import fmpy
import numpy as np
from test_export import Slave

from greygate.emulator.emulation import emulate
from greygate.export.export import export_fmu
from greygate.export.fmu import VERSIONS
from greygate.hardware.build import Project
from greygate.machines.catalog import REPORTED
from greygate.machines.source import Source
from greygate.project import compile_project

from .made import keep
from .shared import scratch, stopwatch

TAKES = "two minutes"


def differing(project: Project, scenario: str, path: Path, folder: Path) -> tuple[int, int]:
    """(steps, values that differ from the emulator's) of a scenario, step by step."""
    program = project.program
    inputs = project.records()[scenario].inputs
    wanted = emulate(program, inputs).outputs
    expected = np.column_stack([v.reshape(len(v), -1) for v in wanted.values()])
    entered = np.column_stack([np.reshape(inputs[p.name], (len(expected), -1)) for p in program.inputs])
    slave = Slave(path, folder).begin()
    names = [v.name for v in slave.about.modelVariables if v.causality == "input"]
    read = [v.name for v in slave.about.modelVariables if v.causality == "output"]
    found = np.empty_like(expected)
    for k, row in enumerate(entered.tolist()):
        slave.set(dict(zip(names, row, strict=True)))
        slave.fmu.doStep(k * program.period, program.period)
        found[k] = slave.get(read)
    slave.close()
    return len(found), int(np.count_nonzero(found.view(np.int64) != expected.view(np.int64)))


def main() -> int:
    rows = []
    for name in REPORTED:
        with scratch() as folder:
            compile_project(Source(name), folder / "build", architectures=("c99",))
            project = Project.open(folder / "build")
            for version in VERSIONS:
                path, watch = folder / f"{name}{version}.fmu", stopwatch()
                export_fmu(folder / "build", path, version)
                seconds = watch(2)
                steps = differ = 0
                for n, scenario in enumerate(project.source.scenarios):
                    more, wrong = differing(project, scenario, path, folder / f"{version}-{n}")
                    steps, differ = steps + more, differ + wrong
                scenarios = len(project.source.scenarios)
                row = {"machine": name, "fmi": version, "scenarios": scenarios, "steps": steps, "differing": differ}
                rows.append({**row, "bytes": path.stat().st_size, "seconds": seconds})
                print(rows[-1], flush=True)
    keep("fmus", "networks", {"fmpy": fmpy.__version__, "rows": rows})
    return int(any(row["differing"] for row in rows))
