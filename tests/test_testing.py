"""The plugin for pytest: in a session of a user's own, a build that is right passes and one that is spoilt fails."""

import pytest

pytest_plugins = ["pytester"]

OURS = """
import pytest
from greygate.testing import assert_bits_equal

@pytest.fixture
def build(greygate_build):
    return greygate_build("line.toml", {"a": "a.csv"}, width=14, architectures=("folded",))

def test_bits(build):
    assert_bits_equal(build, "a", seed=3)

def test_it_is_built_once(build, greygate_build):
    assert greygate_build("line.toml", {"a": "a.csv"}, width=14, architectures=("folded",)) is build
    assert greygate_build("line.toml", {"a": "a.csv"}, width=15, architectures=("folded",)).folder != build.folder

def test_a_scenario_that_is_not_there(build):
    assert_bits_equal(build, "b")

def test_verilog_that_was_changed(build):
    top = build.folder / "rtl" / "folded" / "line.v"
    top.write_text(top.read_text().replace("assign m_axis_tdata = {", "assign m_axis_tdata = 16'd1 ^ {"))
    assert_bits_equal(build, seed=3, as_is=True)
"""


@pytest.fixture
def session(pytester, compiled):
    for name in ("line.toml", "line.safetensors", "a.csv"):
        (pytester.path / name).write_bytes((compiled.parent / name).read_bytes())
    return pytester


@pytest.mark.nightly
def test_a_session_passes_and_fails_where_it_should(session):
    session.makepyfile(OURS)
    done = session.runpytest_subprocess("-p", "no:cacheprovider")
    done.assert_outcomes(passed=2, failed=2)
    done.stdout.fnmatch_lines(
        [
            "*InputError: *no scenario 'b'; there are a*",
            "*build: the Verilog differs from the emulator",
            "folded, a (seed 3): *step 0*",
        ]
    )


def test_the_plugin_costs_a_session_nothing(session):
    session.makepyfile("import sys\ndef test():\n    assert not {'numpy', 'torch', 'numba'} & set(sys.modules)\n")
    session.runpytest_subprocess().assert_outcomes(passed=1)
