"""Synthesis beside its tools: their limit of processor time, and figures that are kept in the package."""

import json
from dataclasses import replace

import pytest
from networks import delay_line

from greygate import project
from greygate.compiler.quantize import Formats
from greygate.errors import InputError
from greygate.hardware import synthesis
from greygate.hardware.synthesis import run_tool
from greygate.pages.report.study import size
from greygate.project import Project, compile_project, synthesize_project
from greygate.source import Source


@pytest.fixture
def module(tmp_path, monkeypatch):
    """A tool of which one entry never ends and one does."""
    (tmp_path / "tool.py").write_text("def busy(words):\n    while True: pass\n\ndef idle(words):\n    return 0\n")
    monkeypatch.syspath_prepend(tmp_path)
    return tmp_path


def test_a_tool_is_stopped_after_its_processor_time(module):
    with pytest.raises(TimeoutError, match="tool: not done in 1 s"):
        run_tool("tool", "busy", [], module, limit=1)
    run_tool("tool", "idle", [], module, limit=1)


@pytest.fixture
def compiled(tmp_path, monkeypatch) -> Project:
    """A small network that takes a name of the catalogue; synthesis counts 42 LUTs, of the parallel design none."""
    (tmp_path / "u.csv").write_text("t_s,u_V,y_m\n" + "".join(f"{k * 1e-3:.3f},{k % 5},{k % 5}\n" for k in range(50)))
    delay_line().save(tmp_path / "b2")
    compile_project(Source(str(tmp_path / "b2.toml"), {"u": str(tmp_path / "u.csv")}), tmp_path / "hw", Formats())
    monkeypatch.setattr(project, "TRAINED", tmp_path)

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
    assert found == {"folded, ecp5": {"luts": 42}, "parallel, ecp5": {"stopped_after_s": 5.0}}
    assert json.loads((tmp_path / "b2.resources.json").read_text()) == {"size": size(named.program), "resources": found}
    (tmp_path / "hw" / "resources.json").unlink()
    assert named.resources == found


def test_a_design_whose_tool_was_stopped_has_no_counts_but_says_so(compiled, monkeypatch):
    def endless(*arguments):
        raise TimeoutError("not done")

    monkeypatch.setattr(synthesis, "run_tool", endless)
    folder = compiled.folder / "rtl" / "folded"
    assert synthesis.synthesize(folder, compiled.program.name, limit=7.0) == {"stopped_after_s": 7.0}
