"""A build from anywhere is data: no entry leads outside it, and no Verilog runs but its program's."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from networks import delay_line

from greygate import project
from greygate.compiler.emit import sources
from greygate.errors import InputError
from greygate.files import write_manifest
from greygate.hardware.build import Project
from greygate.hardware.verify import Comparison, Verification
from greygate.identify.training import train_records
from greygate.machines.source import Source
from greygate.models.network import Network
from greygate.project import synthesize_project, verify_project


def edited(build: Path, name: str, **entries) -> None:
    """Entries of a JSON file changed, and the manifest made to agree, as a stranger can."""
    path = build / name
    path.write_text(json.dumps(json.loads(path.read_text()) | entries))
    write_manifest(build, "compile")


DESIGN = {"multipliers": 4, "factor": 18, "memory": "block", "dsps": 0, "adders": 3, "channels": 1}
PASS = {"name": "p", "layers": 1, "parameters": 1, "multiplications": 1, "change": 0.0, "remarks": []}


@pytest.mark.parametrize(
    ("entries", "says"),
    [
        ({"architectures": ["../../esc"]}, r"architectures\[0\] '../../esc' does not exist; choose parallel, folded"),
        ({"architectures": ["/tmp/esc"]}, r"architectures\[0\] '/tmp/esc'"),
        ({"architectures": []}, "name at least one"),
        ({"architectures": ["folded", "folded"]}, "each once"),
        ({"architectures": "folded"}, "architectures 'folded' is not a list"),
        ({"design": DESIGN | {"multipliers": 10**9}}, "multipliers 1000000000 is not a whole number >= 1 and <= 256"),
        ({"design": DESIGN | {"multipliers": "4"}}, "multipliers '4'"),
        ({"design": DESIGN | {"multipliers": True}}, "multipliers True"),
        ({"design": DESIGN | {"multipliers": 4.0}}, r"multipliers 4\.0"),
        ({"source": ["a"]}, r"source \["),
        ({"recordings": ["a.csv"]}, r"recordings \["),
        ({"recordings": {"a": 5}}, "recordings.a 5 is not a line of text"),
        ({"title": None}, "title None: a text is one line"),
        ({"finer": 10**400}, "finer 1000"),
        ({"passes": {}}, "passes {} is not a list"),
        ({"passes": [PASS | {"change": float("nan")}]}, r"passes\[0\].change nan"),
        ({"passes": [PASS | {"layers": -1}]}, "layers -1"),
        ({"passes": [{"name": "p"}]}, r"passes\[0\].layers is missing"),
        ({"module": "os"}, "'module': there is no such entry"),
    ],
)
def test_an_entry_of_compile_json_of_the_wrong_kind_is_one_line(build, entries, says):
    edited(build, "compile.json", **entries)
    with pytest.raises(InputError, match=says) as refused:
        Project.open(build)
    assert "\n" not in str(refused.value)


VERDICT = {"clocks_per_step": 9.0, "seed": 1, "scenarios": {"a": {"steps": 5, "differing_bits": 0, "mismatch": None}}}


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("verify.json", []),
        ("verify.json", {"parallel": 5}),
        ("verify.json", {"parallel": VERDICT | {"clocks_per_step": float("inf")}}),
        ("verify.json", {"parallel": VERDICT | {"scenarios": {"a": {"steps": 5}}}}),
        ("verify.json", {"parallel": VERDICT | {"seed": "x"}}),
        ("resources.json", {"parallel, ecp5": 5}),
        ("resources.json", {"parallel, ecp5": {"luts": "many"}}),
        ("resources.json", {"parallel, ecp5": {"luts": [1]}}),
        ("resources.json", "text"),
    ],
)
def test_broken_results_are_one_line(build, name, content):
    (build / name).write_text(json.dumps(content))
    opened = Project.open(build)
    with pytest.raises(InputError, match=f"{name}: .* again"):
        _ = opened.hardware, opened.resources
    (build / name).write_text(json.dumps(content)[:-1] + "[" * 90_000)
    with pytest.raises(InputError, match=f"{name}: is not JSON|{name}: .*nested"):
        _ = opened.hardware, opened.resources


def test_sound_results_are_read(build):
    (build / "verify.json").write_text(json.dumps({"parallel": VERDICT}))
    (build / "resources.json").write_text(json.dumps({"parallel, ecp5": {"luts": 5, "clock_mhz": None}}))
    assert Project.open(build).hardware == {"parallel": VERDICT}
    assert Project.open(build).resources == {"parallel, ecp5": {"luts": 5, "clock_mhz": None}}


@pytest.mark.parametrize("name", ["program.json", "network.toml", "network.safetensors", "compile.json"])
def test_a_build_that_was_changed_or_lacks_a_file_is_named(build, name):
    path = build / name
    path.write_bytes(path.read_bytes() + b"\n")
    with pytest.raises(InputError, match=f"{name}: not as greygate compile wrote it"):
        Project.open(build)
    path.unlink()
    with pytest.raises(InputError, match=r"greygate compile (first|wrote)"):
        Project.open(build)


def test_a_link_in_a_build_is_refused(build, tmp_path):
    (build / "simulation").symlink_to(tmp_path)
    with pytest.raises(InputError, match="simulation: not as greygate compile wrote it"):
        Project.open(build)


def test_a_build_of_an_earlier_version_is_told_to_be_compiled_again(build):
    (build / "manifest.json").unlink()
    with pytest.raises(InputError, match=r"no manifest\.json.* run greygate compile again"):
        Project.open(build)


@pytest.mark.parametrize("signed", [False, True])
@pytest.mark.parametrize("change", ["edit", "remove", "list"])
def test_verilog_that_is_not_its_programs_is_neither_simulated_nor_synthesized(build, monkeypatch, signed, change):
    """Even where a stranger's manifest lists it: the program says what the Verilog must be."""
    path = build / "rtl" / "folded" / ("line.f" if change == "list" else "line.v")
    if change == "remove":
        path.unlink()
    else:
        path.write_text(path.read_text() + ("esc.v\n" if change == "list" else 'initial $system("id");\n'))
    if signed:
        write_manifest(build, "compile")
    called = []
    monkeypatch.setattr(project, "verify_many", lambda *a: called.append(a))
    monkeypatch.setattr(project, "synthesize", lambda *a: called.append(a))
    for run in (verify_project, lambda p: synthesize_project(p, "ecp5")):
        with pytest.raises(InputError, match=f"{path}: .*not the Verilog of program.json"):
            run(Project.open(build))
    assert called == []


@pytest.mark.parametrize("line", ["../esc.v", "/tmp/esc.v", "a.v;", "a.py", "deep/a.v", "-f", "a b.v"])
def test_a_list_of_sources_names_plain_files_beside_it_and_nothing_else(build, line):
    listing = build / "rtl" / "folded" / "line.f"
    assert [p.parent for p in sources(listing.parent, "line")] == [listing.parent.resolve()] * len(
        sources(listing.parent, "line")
    )
    listing.write_text(listing.read_text() + line + "\n")
    with pytest.raises(InputError, match="is no plain name of a file beside it"):
        sources(listing.parent, "line")


def test_a_source_that_names_a_python_file_is_not_run(build, tmp_path):
    (tmp_path / "evil.py").write_text(f"open({str(tmp_path / 'ran')!r}, 'w')")
    for name in (str(tmp_path / "evil.py"), str(tmp_path / "evil"), "os", "greygate.cli"):
        edited(build, "compile.json", source=name)
        opened = Project.open(build)
        with pytest.raises(InputError, match=r"no network is called|no such file|is no network"):
            opened.source.network()
    assert not (tmp_path / "ran").exists()


def test_what_lies_in_a_builds_simulation_folder_is_never_built_again(build, monkeypatch):
    """make includes every *.d there, and links objects that are newer than their sources."""
    planted = build / "simulation" / "parallel" / "build" / "Vtop.d"
    planted.parent.mkdir(parents=True)
    planted.write_text("$(shell id)\n")
    seen = []

    def stop(cases, folder, seed):
        seen.append(sorted(folder.rglob("*")))
        raise InputError("far enough")

    monkeypatch.setattr(project, "verify_many", stop)
    with pytest.raises(InputError, match="far enough"):
        verify_project(Project.open(build))
    assert seen
    assert not any(seen)
    thesis = planted.with_name("thesis.d")
    thesis.parent.mkdir(parents=True)
    thesis.write_text("mine")
    with pytest.raises(InputError, match=r"thesis\.d: greygate verify did not write"):
        verify_project(Project.open(build))
    assert thesis.read_text() == "mine"


def test_what_a_verification_found_stands_in_the_build(build, monkeypatch):
    def simulated(cases, folder, seed):
        folder.mkdir(parents=True, exist_ok=True)
        (folder / "results.xml").write_text("<testsuites/>")
        verdicts = tuple(Comparison("line", case.architecture, "a", 20, 9.0, 0.1, None) for case in cases)
        return Verification(verdicts, seed, folder / "results.xml", 0.1, 0.1)

    monkeypatch.setattr(project, "verify_many", simulated)
    for seed in (1, 2):
        done = verify_project(Project.open(build), seed=seed)
        assert Project.open(build).hardware.keys() == done.keys()
        assert all(found["seed"] == seed for found in Project.open(build).hardware.values())


def test_a_training_whose_result_cannot_be_saved_is_not_lost(tmp_path, monkeypatch):
    delay_line().save(tmp_path / "line")
    rows = "".join(f"{k * 1e-3:.3f},{k % 5},{k % 3}\n" for k in range(60))
    (tmp_path / "a.csv").write_text("t_s,u_V,y_m\n" + rows)
    source = Source(str(tmp_path / "line.toml"), {"a": str(tmp_path / "a.csv")})
    start = replace(source.network(), dt=source.period)

    def full(*arguments):
        raise InputError("no space left")

    with monkeypatch.context() as patch:
        patch.setattr(Network, "save", full)
        with pytest.raises(InputError, match="no space left"):
            train_records(start, source.records(), {}, tmp_path / "out", epochs=3)
    assert (tmp_path / "out" / "line.checkpoint").exists()
    assert any(
        "resumed" in remark
        for remark in train_records(start, source.records(), {}, tmp_path / "out", epochs=3)["remarks"]
    )
    assert sorted(p.suffix for p in (tmp_path / "out").iterdir()) == [".json", ".safetensors", ".toml"]
