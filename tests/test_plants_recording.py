"""Recordings and their CSV form."""

import numpy as np
import pytest

from greygate.errors import InputError
from greygate.plants.recording import Recording, read_csv

GOOD = "t_s,v_c_V,x_m\n0,1.5,0.01\n0.001,1.4,0.02\n0.002,1.3,0.03\n"


@pytest.fixture
def csv(tmp_path):
    def write(text):
        path = tmp_path / "run.csv"
        path.write_bytes(text if isinstance(text, bytes) else text.encode())
        return path

    return write


def test_a_header_gives_names_and_units(csv):
    recording = read_csv(csv(GOOD), required={"v_c": "V", "x": "m"})
    assert recording.dt == 0.001
    assert recording.units == {"v_c": "V", "x": "m"}
    assert recording["x"].tolist() == [0.01, 0.02, 0.03]


def test_the_longest_unit_suffix_wins(csv):
    recording = read_csv(csv("t_s,v_true_m_s,z1_ticks_per_s,a_m_s2\n0,1,2,3\n1,1,2,3\n"))
    assert recording.units == {"v_true": "m/s", "z1": "tick/s", "a": "m/s^2"}


def test_an_index_column_and_bare_columns_are_read_only_when_asked_for(csv):
    path = csv("k,u_valve,p_oil\n0,1,2\n1,3,4\n")
    recording = read_csv(path, units={"u_valve": "1", "p_oil": "1"}, dt=0.05)
    assert recording.dt == 0.05
    assert recording["p_oil"].tolist() == [2, 4]
    with pytest.raises(InputError, match="first column is 'k'; give dt"):
        read_csv(path, units={"u_valve": "1", "p_oil": "1"})
    with pytest.raises(InputError, match="column u_valve: unit 'valve' is unknown"):
        read_csv(path, dt=0.05)


def test_what_is_written_reads_back_bit_for_bit(tmp_path):
    values = np.random.default_rng(0).standard_normal((2, 4999)) * 1e-7
    recording = Recording(1e-3, {"p_a": values[0], "v_true": values[1]}, {"p_a": "Pa", "v_true": "m/s"})
    recording.write_csv(tmp_path / "out.csv")
    again = read_csv(tmp_path / "out.csv")
    assert again.dt == recording.dt
    assert again.units == recording.units
    for name in recording.channels:
        np.testing.assert_array_equal(again[name], recording[name])


BAD = {
    "column missing": ("t_s,v_c_V\n0,1\n1,2\n", "column x_m is missing"),
    "unit missing": ("t_s,v_c_V,x\n0,1,2\n1,2,3\n", "column x: has no name or no unit"),
    "unit unknown": ("t_s,v_c_V,x_furlong\n0,1,2\n1,2,3\n", "column x_furlong: unit 'furlong' is unknown"),
    "unit other": ("t_s,v_c_V,x_rad\n0,1,2\n1,2,3\n", "column x is in rad; convert it to m"),
    "time missing": ("v_c_V,x_m\n1,2\n2,3\n", "first column is 'v_c_V'; name the first column t_s"),
    "time not uniform": ("t_s,v_c_V,x_m\n0,1,2\n1,2,3\n2,2,3\n3.5,2,3\n", "row 5, column t_s: step 1.5 s"),
    "time standing": ("t_s,v_c_V,x_m\n1,1,2\n1,2,3\n", "column t_s does not increase"),
    "NaN": ("t_s,v_c_V,x_m\n0,1,2\n1,nan,3\n", "row 3, column v_c_V: 'nan' is not a finite number"),
    "inf": ("t_s,v_c_V,x_m\n0,1,inf\n1,2,3\n", "row 2, column x_m: 'inf'"),
    "text": ("t_s,v_c_V,x_m\n0,1,2\n1,2,broken\n", "row 3, column x_m: 'broken'"),
    "NaN after a blank line": ("t_s,v_c_V,x_m\n0,1,2\n\n1,nan,3\n", "row 4, column v_c_V: 'nan'"),
    "not uniform after a blank line": ("t_s,v_c_V,x_m\n\n0,1,2\n1,2,3\n2,2,3\n3.5,2,3\n", "row 6, column t_s"),
    "ragged after a blank line": ("t_s,v_c_V,x_m\n\n0,1,2\n1,2\n", "row 4 has 2 cells"),
    "ragged": ("t_s,v_c_V,x_m\n0,1,2\n1,2\n", "row 3 has 2 cells, the header 3"),
    "empty file": ("", "the file is empty"),
    "header alone": ("t_s,v_c_V,x_m\n", "holds 0 samples"),
    "one sample": ("t_s,v_c_V,x_m\n0,1,2\n", "holds 1 samples"),
    "one column": ("t_s\n0\n1\n", "header has one column"),
    "twice": ("t_s,v_c_V,x_m,x_m\n0,1,2,3\n1,1,2,3\n", "column x_m appears twice"),
    "binary": (b"\xff\xfe\x00\x01", "the header has one column"),
}


@pytest.mark.parametrize("case", BAD)
def test_a_bad_file_is_refused_in_one_line_that_names_the_place(csv, case):
    text, message = BAD[case]
    path = csv(text)
    with pytest.raises(InputError) as caught:
        read_csv(path, required={"v_c": "V", "x": "m"})
    assert message in str(caught.value)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"none\.csv: cannot be read"):
        read_csv(tmp_path / "none.csv")


def test_writing_into_a_missing_folder_leaves_nothing_behind(tmp_path):
    recording = Recording(1.0, {"x": [0.0, 1.0]}, {"x": "m"})
    with pytest.raises(InputError, match="cannot write here"):
        recording.write_csv(tmp_path / "none" / "out.csv")
    assert list(tmp_path.iterdir()) == []


def test_a_unit_without_suffix_is_refused_before_writing(tmp_path):
    with pytest.raises(InputError, match="unit furlong has no suffix"):
        Recording(1.0, {"x": [0.0, 1.0]}, {"x": "furlong"}).write_csv(tmp_path / "out.csv")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("dt", "channels", "units", "message"),
    [
        (0.0, {"x": [1.0]}, {"x": "m"}, "sample time 0.0 s"),
        (1.0, {"x": [1.0], "y": [1.0, 2.0]}, {"x": "m", "y": "m"}, "same number of samples"),
        (1.0, {"x": []}, {"x": "m"}, "above 0"),
        (1.0, {}, {}, "above 0"),
        (1.0, {"x": [1.0]}, {}, "channel x has no unit"),
        (1.0, {"x": [1.0, np.nan]}, {"x": "m"}, "channel x, sample 1 is nan"),
    ],
)
def test_an_impossible_recording_cannot_be_made(dt, channels, units, message):
    with pytest.raises(InputError, match=message):
        Recording(dt, channels, units)


def test_asking_for_an_absent_channel_names_those_there_are():
    with pytest.raises(InputError, match="no channel p_a; it has x"):
        Recording(1.0, {"x": [0.0]}, {"x": "m"})["p_a"]


def test_a_bare_file_is_read_where_that_is_asked(tmp_path):
    path = tmp_path / "a.csv"
    path.write_text("u,y_m\n1,2\n3,4\n")
    with pytest.raises(InputError, match="name the first column t_s, or give --sample-time"):
        read_csv(path, bare=True)
    recording = read_csv(path, dt=0.5, bare=True)
    assert recording.units == {"u": "1", "y": "m"}
    assert recording["u"].tolist() == [1, 3]
    path.write_text("t_s,u,y_m\n0,1,2\n0.5,3,4\n")
    assert read_csv(path, bare=True).dt == 0.5
    path.write_text("k,y_m,y_bar\n0,1,2\n1,3,4\n")
    with pytest.raises(InputError, match="channel y appears twice"):
        read_csv(path, dt=0.5, bare=True)
    path.write_text("t_s,u\n0,1\n0.5,3\n")
    with pytest.raises(InputError, match="leave out the sample time"):
        read_csv(path, dt=0.5, bare=True)
