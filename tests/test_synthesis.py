"""Synthesis beside its tools: their limit of processor time, and figures that are kept in the package."""

import json
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import pytest
from networks import delay_line

from greygate import project
from greygate.compiler.quantize import Formats
from greygate.compiler.study import size
from greygate.errors import InputError
from greygate.hardware import build, synthesis
from greygate.hardware.build import Project
from greygate.hardware.families import DEVICES, LARGE, QUICK, chosen, placing
from greygate.hardware.synthesis import lacking
from greygate.hardware.tools import run_tool
from greygate.machines.source import Source
from greygate.project import compile_project, synthesize_project


@pytest.fixture
def module(tmp_path, monkeypatch):
    """A tool of which one entry never ends and one does."""
    (tmp_path / "tool.py").write_text("def busy(words):\n    while True: pass\n\ndef idle(words):\n    return 0\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))  # a tool is not looked for in the folder in which it runs
    return tmp_path


def test_a_tool_is_stopped_after_its_processor_time(module):
    with pytest.raises(TimeoutError, match="tool: not done in 1 s"):
        run_tool("tool", "busy", [], module, limit=1)
    run_tool("tool", "idle", [], module, limit=1)


def test_a_tool_tells_its_passes_and_ends_with_the_process_that_called_it(module):
    (module / "teller.py").write_text(
        "import time\n"
        "def talk(words):\n    print('2.1. Executing PROC pass (convert processes).', flush=True)\n    return 0\n"
        "def sleep(words):\n    print(__import__('os').getpid(), flush=True)\n    time.sleep(600)\n"
    )
    told: list[str] = []
    assert "PROC" in run_tool("teller", "talk", [], module, progress=told.append)
    assert told == ["teller: PROC pass (convert processes)"]
    caller = subprocess.Popen(
        [sys.executable, "-c", CALL.format(folder=str(module))], stdout=subprocess.PIPE, text=True
    )
    tool = int(caller.stdout.readline())
    caller.kill()
    caller.wait()
    caller.stdout.close()
    for _ in range(100):
        if not running(tool):
            return
        time.sleep(0.1)
    raise AssertionError("the tool outlives its caller")


CALL = """
import os, sys
sys.path.insert(0, {folder!r})
os.environ["PYTHONPATH"] = {folder!r}
from pathlib import Path
from greygate.hardware import tools
tools.STEP = tools.re.compile(r"(\\d+)")
tools.run_tool("teller", "sleep", [], Path({folder!r}), progress=lambda line: print(line.split()[-1], flush=True))
"""


def running(process: int) -> bool:
    """Whether it is there, and no zombie."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


@pytest.mark.parametrize(("target", "lacks"), [("up5k", ["luts: 9000 of 5280", "dsps: 9 of 8"]), ("ecp5-25k", [])])
def test_a_device_says_what_it_has_too_few_of(target, lacks):
    _, device = chosen(target)
    assert lacking(device, {"luts": 9000, "flip_flops": 100, "dsps": 9, "block_rams": 3.0}) == lacks


def test_the_clock_rate_of_a_family_is_that_of_its_largest_device():
    assert placing("ecp5") is DEVICES["ecp5-85k"]
    assert placing("up5k") is DEVICES["up5k"]
    with pytest.raises(InputError, match="the clock rate is known for target"):
        placing("xc7a35t")


@pytest.fixture
def compiled(tmp_path, monkeypatch) -> Project:
    """A small network that takes a name of the catalogue; synthesis counts 42 LUTs, of the parallel design none."""
    (tmp_path / "u.csv").write_text("t_s,u_V,y_m\n" + "".join(f"{k * 1e-3:.3f},{k % 5},{k % 5}\n" for k in range(50)))
    delay_line().save(tmp_path / "b2")
    compile_project(Source(str(tmp_path / "b2.toml"), {"u": str(tmp_path / "u.csv")}), tmp_path / "hw", Formats())
    monkeypatch.setattr(build, "TRAINED", tmp_path)

    def counted(folder, top, target, clock_rate, limit, mhz, progress):
        return {"luts": 42} if folder.name == "folded" else {"stopped_after_s": limit}

    monkeypatch.setattr(project, "synthesize", counted)
    return Project.open(tmp_path / "hw")


def test_figures_are_kept_for_a_network_of_the_catalogue_only(compiled, tmp_path):
    with pytest.raises(InputError, match="only resources of a network of the catalogue are kept"):
        synthesize_project(compiled, "ecp5", keep=True)
    assert compiled.resources is None
    named = replace(compiled, source=Source("b2", {}))
    found = synthesize_project(named, "ecp5", limit=5.0, keep=True)
    terms = {"edge_bits": 16, "weights": 3}
    assert found == {"folded, ecp5": {"luts": 42} | terms, "parallel, ecp5": {"stopped_after_s": 5.0}}
    assert json.loads((tmp_path / "b2.resources.json").read_text()) == {"size": size(named.program), "resources": found}
    (tmp_path / "hw" / "resources.json").unlink()
    assert named.resources == found


def test_a_design_whose_tool_was_stopped_has_no_counts_but_says_so(compiled, monkeypatch):
    def endless(*arguments):
        raise TimeoutError("not done")

    monkeypatch.setattr(synthesis, "yosys", endless)
    folder = compiled.folder / "rtl" / "folded"
    assert synthesis.synthesize(folder, compiled.program.name, limit=7.0) == {"stopped_after_s": 7.0}


@pytest.mark.parametrize(("luts", "quick"), [(LARGE, False), (LARGE + 1, True)])
def test_a_large_design_goes_to_the_quicker_placer(luts, quick, compiled, monkeypatch):
    def count(script: str, folder: Path, *_) -> str:
        (folder / synthesis.STAT).write_text(json.dumps({"design": {"num_cells_by_type": {"LUT4": luts}}}))
        return ""

    def place(module: str, function: str, arguments: list[str], folder: Path, *_) -> str:
        asked.append(arguments)
        (folder / synthesis.REPORT).write_text(json.dumps({"fmax": {"clk": {"achieved": 50.0}}}))
        return ""

    asked: list[list[str]] = []
    monkeypatch.setattr(synthesis, "yosys", count)
    monkeypatch.setattr(synthesis, "run_tool", place)
    folder = compiled.folder / "rtl" / compiled.designs[0]
    found = synthesis.synthesize(folder, compiled.program.name, "ecp5-85k", clock_rate=True)
    assert (found["luts"], found["clock_mhz"]) == (luts, 50.0)
    assert (" ".join(QUICK) in " ".join(asked[0])) is quick
