"""Every command of diagnosis on random valid rigs ends with an answer: no traceback, no NaN in a file."""

import json

import numpy as np
import pytest
from generated_rigs import KINDS, make

from greygate.mismatch import rig as rigs
from greygate.mismatch.verdict import Verdict

pytestmark = pytest.mark.nightly

SEEDS = {  # of rigs that take a second or two, one of a kind at least; what each has
    0: "a network in windows",
    1: "a chain, and an effect with a state of its own",
    2: "a static plant with time, and a parameter of 0 with a tolerance",
    6: "an input that rests, noise not told",
    8: "a static plant with an input that rests, noise not told",
    9: "no input",
    10: "an imposed motion that rests, and an output that rests",
    11: "what is measured is a definition, with the integral of an input",
    14: "a static plant with told noise",
    1060: "an imposed motion behind a filter that diverges in a trial",
    1086: "a state that no sensor sees and that a trial blows up",
}


def strictly(path):
    """Content of a JSON file for a reader that knows no NaN."""

    def refuse(name):
        raise AssertionError(f"{name} in {path}")

    return json.loads(path.read_text(encoding="utf-8"), parse_constant=refuse)


@pytest.mark.parametrize("seed", SEEDS, ids=SEEDS.values())
def test_every_command_answers(seed, tmp_path, greygate):
    folder = tmp_path / "rig"
    make(seed, folder)
    page, file = tmp_path / "page.html", tmp_path / "d.json"
    code, _, err = greygate("diagnose", folder, "--out", file, "--html", page)
    assert (code, "Warning" in err) == (0, False), err
    assert strictly(file)["verdict"] in list(Verdict)
    assert "</html>" in page.read_text(encoding="utf-8")
    for given in ((), ("--diagnosis", file)):
        code, _, err = greygate("simulate", folder, folder / "identify.csv", "--out", tmp_path / "s.csv", *given)
        assert code == 0, err
    code, out, err = greygate("next", folder, "--diagnosis", file, "--out", tmp_path / "next.csv")
    assert (code, (tmp_path / "next.csv").exists()) in ((0, True), (1, False)), out + err
    code, _, err = greygate("isolability", folder, "--json")
    assert code == 0 or "no table has an effect of this plant" in err, err


def test_a_seed_always_makes_the_same_rig(tmp_path):
    for seed in range(len(KINDS)):
        first, again = (make(seed, tmp_path / name) for name in ("first", "again"))
        assert first == again
        for path in (tmp_path / "first").iterdir():
            assert path.read_bytes() == (tmp_path / "again" / path.name).read_bytes()


def test_all_of_them_are_read(tmp_path):
    """What is drawn is valid, at every time scale."""
    scales = []
    for seed in range(30):
        folder = tmp_path / str(seed)
        make(seed, folder)
        loaded = rigs.load(folder)
        assert loaded.to_explain().samples >= rigs.SHORTEST
        scales.append(loaded.dt)
    assert min(scales) < 1e-5
    assert max(scales) > 10.0


def test_a_holdout_that_diverges_is_null_in_the_file_and_said_to_diverge(tmp_path, greygate):
    """A pendulum-like rig that the recorded pushes leave upright and those of holdout.csv throw over."""
    (tmp_path / "rig.toml").write_text(RIG)
    (tmp_path / "plant.toml").write_text(PLANT)
    for name, size in (("identify", 0.1), ("holdout", 1e3)):
        rng, x, rows = np.random.default_rng(1), 0.0, []
        for k, u in enumerate(size * np.repeat(rng.standard_normal(60), 5)):
            rows.append((0.1 * k, u, x + 1e-3 * rng.standard_normal()))
            x += 0.1 * (u - x)
        np.savetxt(tmp_path / f"{name}.csv", rows, delimiter=",", header="t,u,x", comments="")
    file = tmp_path / "d.json"
    code, out, err = greygate("diagnose", tmp_path, "--out", file, "--html", tmp_path / "page.html")
    assert code == 0, err
    assert strictly(file)["fit"]["holdout"]["x"]["simulation"] is None
    assert "diverges" in out


PLANT = """
step = 0.1
outputs = ["x"]
inputs = { u = "1" }
parameters = { grow = [0.5, "1"], back = [1.0, "1"] }
states = { x = { unit = "1" } }
equations.rate = { x = { drive = "u", back = "-back * x", cubic = "grow * x**3" } }
"""
RIG = """
plant = "plant.toml"
sample_time_s = 0.1
predict = ["x"]
parameters = { grow = 0.01, back = 1.0 }
tolerance = { back = 0.1 }
channels.u = { unit = "1", role = "input" }
channels.x = { unit = "1", role = "output", noise_rms = 1e-3 }
"""
