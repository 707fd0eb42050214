"""`greygate emulate`: what it counts and says."""

import json
import re

import numpy as np
import pytest

from greygate.emulator.program import Program
from greygate.models.network import Layer, Network, Port


@pytest.fixture
def built(greygate, tmp_path):
    """A network of one input in V about 1 V and one in N, compiled on recordings of -1 to 3 V and -5 to 5 N."""
    inputs = [Port("u", "V", scale=2.0, offset=1.0), Port("w", "N", scale=5.0)]
    network = Network("line", inputs, [Port("y", "m")])
    network.add("sum", Layer({"u": [[1.0]], "w": [[0.5]]}, [0.0]))
    network.connect("u", "sum.u")
    network.connect("w", "sum.w")
    network.connect("sum", "y")
    network.save(tmp_path / "line")
    rng = np.random.default_rng(0)
    u, w = rng.uniform(-1, 3, 80), rng.uniform(-5, 5, 80)
    record = write(tmp_path / "a.csv", u, w)
    code, _, error = greygate("compile", tmp_path / "line.toml", f"a={record}", "--out", tmp_path / "build")
    assert code == 0, error
    return tmp_path / "build"


def write(path, u, w):
    values = enumerate(zip(u.tolist(), w.tolist(), strict=True))
    rows = [f"{k * 1e-3:.3f},{a!r},{b!r},{0.1 * k!r}" for k, (a, b) in values]
    path.write_text("\n".join(["t_s,u_V,w_N,y_m", *rows]) + "\n")
    return path


def test_inputs_outside_their_formats_are_counted_with_both_ranges(greygate, built, tmp_path):
    u, w = np.full(40, 1.0), np.linspace(-1, 1, 40)
    u[:3], u[3] = 1e3, -1e9
    record = write(tmp_path / "b.csv", u, w)
    port = Program.load(built / "program.json").inputs[0]
    fix = port.signal.fix
    holds = [float(code) * fix.lsb * 2.0 + 1.0 for code in (fix.lo, fix.hi)]
    code, out, error = greygate("emulate", built, record, "--out", tmp_path / "p.csv", "--json")
    assert code == 0, error
    found = json.loads(out)["clipped"]
    assert found == {"u": {"count": 4, "share": 0.1, "holds": holds, "given": [-1e9, 1e3]}}
    _, out, _ = greygate("emulate", built, record, "--out", tmp_path / "p.csv")
    ranges = f"{holds[0]:.6g} to {holds[1]:.6g} V"
    said = f"input u: 4 samples (10.00%) clipped to {ranges}, which {fix} holds; given -1e+09 to 1000 V"
    assert out.splitlines()[1] == said
    assert "clipped inputs 1" in out.splitlines()[0]


def test_every_sample_outside_the_format_is_not_silent(greygate, built, tmp_path):
    record = write(tmp_path / "b.csv", np.full(40, 99.0), np.full(40, -99.0))
    _, out, _ = greygate("emulate", built, record, "--out", tmp_path / "p.csv")
    assert len(re.findall(r"^input [uw]: 40 samples \(100\.00%\) clipped to ", out, re.M)) == 2


def test_inputs_that_fit_are_said_to_fit(greygate, built, tmp_path):
    code, out, _ = greygate("emulate", built, tmp_path / "a.csv", "--out", tmp_path / "p.csv")
    assert code == 0
    assert out.splitlines()[0] == "80 steps, saturations none, clipped inputs none"


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
def test_an_input_that_is_no_number_is_refused_and_nothing_is_written(greygate, built, tmp_path, value):
    record = write(tmp_path / "b.csv", np.ones(40), np.ones(40))
    record.write_text(record.read_text().replace("0.004,1.0", f"0.004,{value}"))
    code, out, error = greygate("emulate", built, record, "--out", tmp_path / "p.csv")
    assert code == 2
    assert out == ""
    assert len(error.splitlines()) == 1
    assert not (tmp_path / "p.csv").exists()


def test_a_scenario_of_the_build_is_its_recording(greygate, built, tmp_path):
    answers = []
    for given in (tmp_path / "a.csv", "a"):
        code, _, error = greygate("emulate", built, given, "--out", tmp_path / "p.csv")
        assert code == 0, error
        answers.append((tmp_path / "p.csv").read_bytes())
    assert answers[0] == answers[1]
    code, _, error = greygate("emulate", built, "b", "--out", tmp_path / "q.csv")
    assert code == 2
    assert "b: no such file, and no scenario of this build; it has a" in error
    assert not (tmp_path / "q.csv").exists()
