"""A network on a board: the folder that is written, its frames, and a recording played through it bit by bit."""

import json
import re
import shutil
import subprocess
import time
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import simulated_board

from greygate.emulator import engine
from greygate.errors import InputError
from greygate.hardware import verify
from greygate.hardware.board import make as making
from greygate.hardware.board.boards import BOARDS, PLLS, PORTS
from greygate.hardware.board.frames import IDLE, Answer, Frames, check_sum
from greygate.hardware.board.make import make
from greygate.hardware.board.play import Session, opened, play
from greygate.hardware.build import Project

CLOCKS = 8  # of a bit in simulation
STEPS = 300
TICK = 50  # clocks: far fewer than a frame takes, so that ticks find no sample
QUICK = ("OPT_FAST=-O0", "OPT_SLOW=-O0", "OPT_GLOBAL=-O0")  # for the compiler of a simulation that runs a moment


@pytest.fixture(scope="module")
def packages(compiled, tmp_path_factory):
    """The same network on every board behind every port, and in both architectures."""
    folder, project = tmp_path_factory.mktemp("boards"), Project.open(compiled)
    for board in BOARDS:
        for port in PORTS:
            architecture = "folded" if port == "uart" else "parallel"
            tick = (board, port) == ("ulx3s", "spi")
            make(project, board, folder / f"{board}-{port}", architecture=architecture, port=port, tick=tick)
    return folder


@pytest.fixture(scope="module")
def built(packages, tmp_path_factory):
    return simulated_board.build(packages / "icebreaker-uart", tmp_path_factory.mktemp("simulated"), CLOCKS, TICK)


@pytest.fixture(scope="module")
def terminal(built):
    with simulated_board.running(built, CLOCKS) as path:
        yield path


@pytest.fixture(scope="module")
def scenario(compiled):
    """A program, random inputs, and the emulator's answers."""
    program = Project.open(compiled).program
    fix = program.inputs[0].signal.fix
    codes = np.random.default_rng(0).integers(fix.lo, fix.hi + 1, (STEPS, 1))
    return program, codes, engine.run(program, codes).outputs


# The frames


def test_the_check_sum_is_the_one_that_others_compute():
    assert check_sum(b"123456789", 0) == (0x2189).to_bytes(2, "little")  # CRC-16/KERMIT
    assert check_sum(b"123456789", 0xFFFF) == (0x906E ^ 0xFFFF).to_bytes(2, "little")  # X-25, not inverted


def test_an_answer_is_found_among_other_bytes_and_no_damaged_one_is_taken():
    frames = Frames(sample=2, result=3, seed=77)
    good = frames.answer(b"\x55\x55\x03", 33)
    damaged = bytes([good[0], good[1] ^ 1, *good[2:]])
    received = bytearray(b"\x55\x01" + damaged + bytes([IDLE]) + good + good[:4])
    assert frames.parse(received) == Answer(1, False, False, False, b"\x55\x55\x03")
    assert frames.parse(received) is None
    received += good[4:]
    assert frames.parse(received).result == b"\x55\x55\x03"
    assert Frames(2, 3, seed=78).parse(bytearray(good)) is None


# The folder


def test_every_package_lints_and_holds_what_its_lists_name(packages):
    environment = verify.simulator_environment()

    def lint(folder):
        files = [f"rtl/{name}" for name in (folder / "rtl" / "line.f").read_text().split()]
        port = [name for name in files if name != "rtl/line__top.v"]
        wrappers = ["rtl/line__axis.v", "rtl/line__axis_last.v", "rtl/greygate_last.v"]
        for top, sources in (("port", port), ("axis_last", [*wrappers[1:], *port]), ("axis", [*wrappers[:1], *port])):
            command = ["verilator", "--lint-only", "-Wall", "--quiet", "--top-module", f"line__{top}", *sources]
            done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
            assert done.returncode == 0, f"{folder}: {done.stderr}"
            if shutil.which("iverilog"):
                command = ["iverilog", "-g2005", "-Wall", "-o", f"{folder}/none", "-s", f"line__{top}", *sources]
                done = subprocess.run(command, cwd=folder, capture_output=True, text=True)
                assert (done.returncode, done.stderr) == (0, ""), folder

    with ThreadPoolExecutor(2) as pool:
        list(pool.map(lint, (packages / name for name in ("icebreaker-uart", "ulx3s-spi"))))


@pytest.mark.parametrize("board", BOARDS)
@pytest.mark.parametrize("port", PORTS)
def test_the_pins_are_those_of_the_top(packages, board, port):
    folder = packages / f"{board}-{port}"
    ports = re.findall(r"^    (?:input|output) +wire (\w+)", (folder / "rtl" / "line__top.v").read_text(), re.M)
    pins = next(folder.glob("line.[plx][cpd][fc]")).read_text()
    found = re.findall(r'^set_io (\w+)|^LOCATE COMP "(\w+)"|get_ports (\w+)\]$', pins, re.M)
    assert sorted({name for row in found for name in row} - {""}) == sorted(ports)
    inputs, outputs = PORTS[port]
    assert {*inputs, *outputs, "clk", "running", "fault", "tick"} <= {*ports}


@pytest.mark.skipif(not shutil.which("iverilog"), reason="needs Icarus Verilog")
@pytest.mark.parametrize("port", PORTS)
def test_the_benches_pass_in_icarus_and_fail_where_a_bit_differs(packages, port, tmp_path):
    folder = shutil.copytree(packages / f"icebreaker-{port}", tmp_path / "p")
    done = subprocess.run(["make", "-s", "test"], cwd=folder, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    assert re.findall("^PASS: .*", done.stdout, re.M) == [
        re.search("^PASS: 20 steps in .* clocks, every bit equal$", done.stdout, re.M).group(),
        "PASS: 22 frames, 20 steps, every bit equal",
    ]
    assert done.stderr == ""
    for name, bench in (("scenario.hex", "line__bench"), ("frames.hex", "line__port_bench")):
        lines = (folder / name).read_text().splitlines()
        lines[7] = f"{int(lines[7], 16) ^ 1 << (4 * len(lines[7]) - 6):0{len(lines[7])}x}"
        (folder / name).write_text("\n".join(lines) + "\n")
        done = subprocess.run(["make", "-s", f"icarus-{bench}"], cwd=folder, capture_output=True, text=True)
        assert done.returncode != 0
        assert re.search(r"^FAIL: (step|frame) 7 ", done.stdout, re.M)


def test_a_bench_passes_in_verilator(packages, tmp_path):
    """That of the port, which runs on delays."""
    folder = shutil.copytree(packages / "icebreaker-uart", tmp_path / "p")
    command = ["make", "-s", "verilator-line__port_bench", "CFG_CXXFLAGS_PCH_I=-include", *QUICK]
    done = subprocess.run(command, cwd=folder, env=verify.simulator_environment(), capture_output=True, text=True)
    assert "PASS: 22 frames, 20 steps, every bit equal" in done.stdout, done.stdout + done.stderr


def test_the_scripts_can_be_read(packages):
    """The core file as YAML, the Tcl as whole commands; each file that they name is there."""
    yaml = pytest.importorskip("yaml")
    for folder in packages.iterdir():
        head, _, rest = (folder / "line.core").read_text().partition("\n")
        core = yaml.safe_load(rest)
        assert head == "CAPI=2:"
        for files in core["filesets"].values():
            for file in files["files"]:
                assert (folder / (file if isinstance(file, str) else next(iter(file)))).is_file()
        for target in core["targets"].values():
            assert {*target["filesets"]} <= {*core["filesets"]}
    tkinter = pytest.importorskip("tkinter")
    for name in ("build.tcl", "line.xdc"):
        text = (packages / "arty-a7-uart" / name).read_text()
        assert tkinter.Tcl().call("info", "complete", text)


def test_the_vivado_script_runs_its_commands_on_the_files_that_are_there(packages, monkeypatch):
    """In Tcl itself, with a stand-in for each command of Vivado."""
    monkeypatch.chdir(packages / "arty-a7-uart")
    tcl = pytest.importorskip("tkinter").Tcl()
    tcl.eval("set log {}; proc unknown args { lappend ::log $args; return 1 }")
    tcl.eval((packages / "arty-a7-uart" / "build.tcl").read_text())
    tcl.eval((packages / "arty-a7-uart" / "line.xdc").read_text())
    called = [tcl.splitlist(row) for row in tcl.splitlist(tcl.eval("set log"))]
    read = [row[1] for row in called if row[0] == "read_verilog"]
    assert read == [f"rtl/{name}" for name in (packages / "arty-a7-uart/rtl/line.f").read_text().split()]
    assert ("write_bitstream", "-force", "line.bit") in called
    assert ("synth_design", "-top", "line__top", "-part", "xc7a35ticsg324-1L") in called


@pytest.mark.parametrize(
    ("pll", "given", "wanted", "made"),
    [
        ("sb_pll40", 12, 24, lambda p: 12 / (p["DIVR"] + 1) * (p["DIVF"] + 1) / 2 ** p["DIVQ"]),
        ("sb_pll40", 12, 30, lambda p: 12 / (p["DIVR"] + 1) * (p["DIVF"] + 1) / 2 ** p["DIVQ"]),
        ("sb_pll40", 12, 20.25, lambda p: 12 / (p["DIVR"] + 1) * (p["DIVF"] + 1) / 2 ** p["DIVQ"]),
        ("ehxplll", 25, 60, lambda p: 25 / p["CLKI_DIV"] * p["CLKFB_DIV"]),
        ("plle2", 100, 50, lambda p: 100 / p["DIVCLK_DIVIDE"] * p["CLKFBOUT_MULT"] / p["CLKOUT0_DIVIDE"]),
    ],
)
def test_a_pll_makes_the_frequency(pll, given, wanted, made):
    assert made(PLLS[pll](given, wanted)) == pytest.approx(wanted, rel=1e-4)
    assert PLLS[pll](given, 0.01) is None


@pytest.mark.parametrize(
    ("how", "why"),
    [
        ({"name": "arduino"}, "board 'arduino' does not exist; choose ulx3s"),
        ({"port": "usb"}, "--interface usb: choose uart or spi"),
        ({"architecture": "listing"}, "has no architecture 'listing'; it has parallel, folded"),
        ({"mhz": 23.4567}, "--mhz 23.4567: the PLL of this board does not make it of 12 MHz"),
        ({"baud": 9_000_000}, "--baud 9000000: a clock of 24 MHz does not give it"),
        ({"name": "arty-a7", "bitstream": True}, "its bitstream is made by its vendor's tool alone"),
    ],
)
def test_what_does_not_exist_is_refused_before_anything_is_written(compiled, tmp_path, how, why):
    how = {"name": "icebreaker"} | how
    with pytest.raises(InputError, match=re.escape(why)):
        make(Project.open(compiled), out=tmp_path / "out", **how)
    assert list(tmp_path.iterdir()) == []


def test_changed_verilog_is_not_put_on_a_board(build, tmp_path):
    (path,) = build.glob("rtl/folded/line.v")
    path.write_text(path.read_text() + "// mine\n")
    with pytest.raises(InputError, match=r"is not the Verilog of program\.json"):
        make(Project.open(build), "icebreaker", tmp_path / "out")


@pytest.fixture
def tools(monkeypatch):
    """Tools that leave what nextpnr would, at `rate` MHz."""
    called = []

    def run(module, function, arguments, folder, limit=None, progress=None):
        called.append(function)
        (folder / "line.json").touch()
        (folder / "line.asc").touch()
        report = {"fmax": {"clk": {"achieved": run.rate}}, "utilization": {"ICESTORM_LC": {"used": 7, "available": 9}}}
        (folder / "line__report.json").write_text(json.dumps(report))

    run.rate = 25.0
    monkeypatch.setattr(making, "run_tool", run)
    monkeypatch.setattr(making, "yosys", lambda script, folder, progress: called.append(script.split("; ")[1]))
    run.called = called
    return run


def test_a_bitstream_is_made_only_if_the_clock_is_reached(compiled, tmp_path, tools):
    facts = make(Project.open(compiled), "icebreaker", tmp_path / "out", bitstream=True)
    assert tools.called == ["synth_ice40 -dsp -top line__top -json line.json", "run_nextpnr_ice40", "run_icepack"]
    assert (facts["reached_mhz"], facts["cells"]) == (25.0, {"ICESTORM_LC": 7})
    assert json.loads((tmp_path / "out" / "board.json").read_text()) == facts
    tools.rate = 23.9
    facts = make(Project.open(compiled), "icebreaker", tmp_path / "new", bitstream=True)
    assert (facts["meets"], facts["bitstream"], facts["reached_mhz"]) == (False, None, 23.9)
    assert (tmp_path / "new" / "Makefile").exists()
    assert not list((tmp_path / "new").glob("*.bin"))


def test_a_missed_clock_is_a_no(greygate, compiled, tmp_path, tools):
    tools.rate = 23.9
    code, out, err = greygate("board", "icebreaker", compiled, "--out", tmp_path / "out", "--bitstream", "--json")
    assert code == 1
    assert json.loads(out)["meets"] is False
    assert "no bitstream: reaches 23.9 MHz on this board, not 24; give --mhz 23 or less" in err


def test_a_design_that_is_too_large_is_told_with_what_to_do(compiled, tmp_path, tools, monkeypatch):
    def full(module, function, arguments, folder, limit=None, progress=None):
        if "nextpnr" in function:
            raise InputError(
                "nextpnr failed: ERROR: no BELs remaining to implement cell type 'ICESTORM_DSP'; try another"
            )

    monkeypatch.setattr(making, "run_tool", full)
    with pytest.raises(
        InputError, match=r"does not fit 1BitSquared iCEBreaker, iCE40UP5K, too few ICESTORM_DSP; compile"
    ):
        make(Project.open(compiled), "icebreaker", tmp_path / "out", bitstream=True)
    assert list(tmp_path.iterdir()) == []


# Playing


def test_every_bit_of_a_recording_comes_back_equal(greygate, compiled, terminal):
    code, out, _ = greygate("play", compiled, "a", "--port", terminal, "--json")
    found = json.loads(out)
    assert code == 0
    assert (found["samples"], found["differing_bits"]) == (20, 0)
    assert found["overruns"] == 20
    code, out, _ = greygate("play", compiled, compiled.parent / "a.csv", "--port", terminal)
    assert code == 0
    assert out.startswith("20 samples, differing bits 0: every bit equal to the emulator\n")


def test_a_differing_bit_is_counted_and_named(scenario, terminal):
    program, codes, right = scenario
    wrong = right.copy()
    wrong[3, 0] ^= 6
    with opened(terminal, 115200) as line:
        played = play(program, codes, wrong, line)
    assert (played.samples, played.differing_samples, played.differing_bits) == (STEPS, 1, 2)
    assert played.mismatch == f"step 3: y has the code {right[3, 0]} instead of {wrong[3, 0]}"


def test_a_command_that_finds_a_differing_bit_exits_with_1(greygate, compiled, terminal, monkeypatch):
    honest = engine.run

    def run(*arguments, **how):
        answer = honest(*arguments, **how)
        answer.outputs[5] ^= 1
        return answer

    monkeypatch.setattr(engine, "run", run)
    code, out, _ = greygate("play", compiled, "a", "--port", terminal)
    assert code == 1
    assert "20 samples, differing bits 1: step 5: y has the code" in out


def test_noise_on_the_line_costs_time_and_no_bit(scenario, built):
    program, codes, right = scenario
    with simulated_board.running(built, CLOCKS, flip=1201) as path, opened(path, 1_000_000) as line:
        played = play(program, codes, right, line)
    assert (played.samples, played.differing_bits) == (STEPS, 0)
    assert played.resent > 0


class Board:
    """A board without hardware, whose result is the sample and how many were stepped since the restart.

    late: step whose answer comes half a second after the others. lost: step whose answer is lost the first time.
    """

    baudrate = 1_000_000

    def __init__(self, frames, late=-1, lost=-1):
        self.frames, self.late, self.lost = frames, late, lost
        self.heard, self.said, self.at = bytearray(), bytearray(), 0.0
        self.next, self.stepped, self.result = 0, 0, bytes(frames.result)

    def write(self, data):
        self.heard += data
        while (at := self.heard.find(0x55)) >= 0 and len(self.heard) - at >= self.frames.request_size:
            body = bytes(self.heard[at + 1 : at + self.frames.request_size])
            del self.heard[: at + self.frames.request_size]
            self.step(body[0], body[1:-2], check_sum(body[:-2], self.frames.seed) == body[-2:])

    def step(self, tag, sample, right):
        restart, number = tag >> 7, tag % 32
        if refused := not (right and (restart or number == self.next)):
            self.said += self.frames.answer(self.result, self.next, refused=True)
            return
        self.stepped = 1 if restart else self.stepped + 1
        self.next, self.result = (number + 1) % 32, sample + bytes([self.stepped % 256])
        if self.stepped == self.late:
            self.at, self.late = time.monotonic() + 0.5, -1
        if self.stepped == self.lost:
            self.lost = -1
        else:
            self.said += self.frames.answer(self.result, self.next, refused)

    def read(self, size=1):
        data = self.said[:size] if time.monotonic() > self.at else b""
        del self.said[: len(data)]
        return bytes(data)


@pytest.mark.parametrize(("trouble", "restarts"), [({}, 0), ({"late": 20}, 0), ({"lost": 20}, 1), ({"lost": 100}, 0)])
def test_a_late_answer_is_waited_for_and_a_lost_one_is_asked_for_or_played_again(trouble, restarts):
    frames = Frames(sample=2, result=3, seed=5)
    samples = [k.to_bytes(2, "little") for k in range(100)]
    session = Session(Board(frames, **trouble), frames, samples)
    session.run()
    assert session.results == [sample + bytes([k + 1]) for k, sample in enumerate(samples)]
    assert session.restarts == restarts


def test_outputs_at_the_end_of_their_format_are_flagged(scenario, terminal):
    program, codes, _ = scenario
    fix = program.outputs[0].signal.fix
    codes = np.full_like(codes, program.inputs[0].signal.fix.hi)
    right = engine.run(program, codes).outputs
    with opened(terminal, 1_000_000) as line:
        played = play(program, codes, right, line)
    assert played.differing_bits == 0
    assert played.limited == np.isin(right, (fix.lo, fix.hi)).sum()


@pytest.mark.parametrize(
    ("echo", "why"),
    [(False, "nothing answers: load the bitstream"), (True, "what answers is no board with this build")],
)
def test_a_port_without_the_board_is_told_apart(scenario, echo, why):
    class Line:
        baudrate = 10_000_000

        def __init__(self):
            self.waiting = b""

        def write(self, data):
            self.waiting += data if echo else b""

        def read(self, size=1):
            data, self.waiting = self.waiting[:size], self.waiting[size:]
            return data

    program, codes, right = scenario
    with pytest.raises(InputError, match=why):
        play(program, codes, right, Line())


def test_a_board_with_another_program_is_none(scenario, terminal):
    frames = Frames.of(scenario[0])
    with (
        opened(terminal, 1_000_000) as line,
        pytest.raises(InputError, match=r"nothing answers|no board with this build"),
    ):
        Session(line, Frames(frames.sample, frames.result, frames.seed ^ 1), [b"\0" * frames.sample]).run()


def test_a_port_that_cannot_be_played_is_one_line(greygate, compiled, tmp_path):
    code, _, err = greygate("play", compiled, "a", "--port", tmp_path / "tty")
    assert (code, len(err.splitlines())) == (2, 1)
    assert "cannot be opened" in err
    code, _, err = greygate("play", compiled, "b", "--port", tmp_path / "tty")
    assert code == 2
    assert "b: no such file, and no scenario of this build; it has a" in err


def test_the_command_writes_a_folder_and_says_what_is_in_it(greygate, compiled, tmp_path):
    code, out, _ = greygate("board", "ulx3s-25f", compiled, "--out", tmp_path / "out", "--mhz", "50", "--json")
    found = json.loads(out)
    assert (code, found["clock_mhz"], found["architecture"]) == (0, 50.0, "folded")
    assert "EHXPLLL" in (tmp_path / "out/rtl/line__top.v").read_text()
    assert "--25k" in (tmp_path / "out/Makefile").read_text()
    (tmp_path / "out" / "mine").touch()
    code, _, err = greygate("board", "ulx3s", compiled, "--out", tmp_path / "out")
    assert code == 2
    assert "holds other files (mine)" in err
