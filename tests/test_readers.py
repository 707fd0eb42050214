"""One reader for the recordings of other tools: the same numbers from every format and every header."""

import gzip
import importlib
import json
import os
import re
import subprocess
import sys

import checking
import h5py
import numpy as np
import pytest
from command_line import greygate
from imported_models import write_v73
from scipy.io import savemat

from greygate.errors import InputError
from greygate.foreign import child, read_mat
from greygate.pages import recorded
from greygate.pages.zoomable import POINTS, unpacked
from greygate.plants.readers.columns import Channel
from greygate.plants.readers.read import read_channels, read_recording
from greygate.plants.units.reading import converted, split

DT, N = 1e-3, 50
RNG = np.random.default_rng(0)
VALUES = {"v_c": RNG.standard_normal(N), "x": RNG.standard_normal(N) / 3, "p_a": 1e5 + 1e4 * RNG.standard_normal(N)}
UNITS = {"v_c": "V", "x": "m", "p_a": "Pa"}
TIME = DT * np.arange(N)


def text(headers, units_row=None, separator=","):
    rows = [separator.join(headers), *([separator.join(units_row)] if units_row else [])]
    rows += [separator.join(f"{v!r}" for v in map(float, row)) for row in zip(TIME, *VALUES.values(), strict=True)]
    return "\n".join(rows) + "\n"


def csv_house(path):
    path.write_text(text(["t_s", "v_c_V", "x_m", "p_a_Pa"]))


def csv_brackets(path):
    path.write_text(text(["t [s]", "v_c [V]", "x [m]", "p_a [Pa]"]))


def csv_row(path):
    path.write_text(text(["time", "v_c", "x", "p_a"], ["s", "V", "m", "Pa"], ";"))


def csv_beside(path):
    path.write_bytes(gzip.compress(text(["seconds", "v_c", "x", "p_a"]).encode()))
    lines = "\n".join(f'{n} = "{u}"' for n, u in UNITS.items())
    path.with_name("record.units.toml").write_text(f'time = "seconds"\n[units]\n{lines}\n')


def mat5(path):
    savemat(path, {"t": TIME, **VALUES, "units": UNITS})


def npz(path):
    np.savez(path, t=TIME, **{f"{name} [{UNITS[name]}]": values for name, values in VALUES.items()})


def mat73(path):
    write_v73(path, {"data": {"time": TIME, **VALUES, "units": UNITS}})


def hdf5(path):
    with h5py.File(path, "w") as file:
        file["t"] = TIME
        for name, values in VALUES.items():
            file[name] = values
            file[name].attrs["unit"] = UNITS[name]


def parquet(path):
    import pyarrow
    import pyarrow.parquet

    fields = [pyarrow.field(n, pyarrow.float64(), metadata={"unit": u}) for n, u in UNITS.items()]
    table = pyarrow.table(
        [pyarrow.array(TIME), *map(pyarrow.array, VALUES.values())],
        schema=pyarrow.schema([pyarrow.field("t", pyarrow.float64()), *fields]),
    )
    pyarrow.parquet.write_table(table, path)


def mdf4(path):
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        file.append([Signal(v, TIME, name=n, unit=UNITS[n]) for n, v in VALUES.items()])
        file.save(path)


def tdms(path):
    from nptdms import ChannelObject, TdmsWriter

    with TdmsWriter(path) as writer:
        properties = {"wf_increment": DT, "wf_start_offset": 0.0}
        writer.write_segment(
            [ChannelObject("run", n, v, properties={**properties, "unit_string": UNITS[n]}) for n, v in VALUES.items()]
        )


def mcap(path):
    from mcap.writer import Writer

    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("sample", "jsonschema", b"{}")
        channel = writer.register_channel("/rig", "json", schema)
        for k in range(N):
            sample = {f"{n}_{UNITS[n]}": float(v[k]) for n, v in VALUES.items()}
            at = k * 1_000_000
            writer.add_message(channel, at, json.dumps(sample).encode(), at)
        writer.finish()


FORMATS = {
    "record.csv": csv_house, "brackets.csv": csv_brackets, "row.csv": csv_row, "record.csv.gz": csv_beside,
    "v5.mat": mat5, "v73.mat": mat73, "record.h5": hdf5, "record.parquet": parquet, "record.mf4": mdf4,
    "record.tdms": tdms, "record.mcap": mcap, "record.npz": npz,
}  # fmt: skip


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", FORMATS)
def test_one_record_gives_the_same_array_in_every_format(name, tmp_path):
    FORMATS[name](tmp_path / name)
    found = read_recording(tmp_path / name)
    assert (found.dt, dict(found.units)) == (DT, UNITS)
    assert {n: v.tolist() for n, v in found.channels.items()} == {n: v.tolist() for n, v in VALUES.items()}


def test_an_archive_of_numpy_holds_numbers_alone(tmp_path):
    odd = {"square": np.eye(3), "words": np.array(["a", "b"]), "late": np.asfortranarray(TIME.reshape(-1, 1))}
    np.savez_compressed(tmp_path / "a.npz", t=TIME, **odd)
    with pytest.raises(InputError, match="late: has no unit"):
        read_recording(tmp_path / "a.npz")
    found = read_recording(tmp_path / "a.npz", units={"late": "s"})
    assert found["late"].tolist() == TIME.tolist()
    np.savez(tmp_path / "b.npz", t=TIME, u=np.array([{}] * N, object))
    with pytest.raises(InputError, match="no channel"):
        read_recording(tmp_path / "b.npz")
    np.savez_compressed(tmp_path / "c.npz", t=np.zeros(40_000_000))
    with pytest.raises(InputError, match="unpacks to more than"):
        read_recording(tmp_path / "c.npz")


@pytest.mark.filterwarnings("ignore")
def test_frames_and_dictionaries_are_recordings_too():
    import pandas

    columns = {"t [s]": TIME, **{f"{n} [{UNITS[n]}]": v for n, v in VALUES.items()}}
    for source in (columns, pandas.DataFrame(columns)):
        found = read_recording(source)
        assert {n: v.tolist() for n, v in found.channels.items()} == {n: v.tolist() for n, v in VALUES.items()}
    stamped = pandas.DataFrame({**columns, "t [s]": pandas.to_datetime(TIME, unit="s")})
    assert read_recording(stamped).dt == DT
    with pytest.raises(InputError, match="'float' is no recording"):
        read_recording(1.5)


HEADERS = [  # header, name, unit as the recording has it, what 2 becomes
    ("p_a_Pa", "p_a", "Pa", 2.0), ("p_a_bar", "p_a", "bar", 2.0), ("p_a [bar]", "p_a", "bar", 2.0),
    ("p_a (bar)", "p_a", "bar", 2.0), ("p_a / bar", "p_a", "bar", 2.0), ("p_a in bar", "p_a", "bar", 2.0),
    ("p_a, bar", "p_a", "bar", 2.0), ("p_a: kPa", "p_a", "Pa", 2000.0), ("p_a{MPa}", "p_a", "Pa", 2e6),
    ("p_psi", "p", "Pa", 13789.514586), ("Pressure A [psi]", "Pressure_A", "Pa", 13789.514586),
    ("speed_rad/s", "speed", "rad/s", 2.0), ("slope_m/s²", "slope", "m/s^2", 2.0),
    ("n_rpm", "n", "rad/s", 0.20943951), ("n [1/min]", "n", "rad/s", 0.20943951),
    ("n [rpm]", "n", "rad/s", 0.20943951),
    ("phi_deg", "phi", "rad", 0.034906585), ("phi [°]", "phi", "rad", 0.034906585),
    ("w [deg/s]", "w", "rad/s", 0.034906585),
    ("T_degC", "T", "K", 275.15), ("T [°C]", "T", "K", 275.15), ("T (degF)", "T", "K", 256.483333333),
    ("Q_L_min", "Q", "m^3/s", 3.3333333e-5), ("Q [l/min]", "Q", "m^3/s", 3.3333333e-5),
    ("Q [m³/h]", "Q", "m^3/s", 5.5555556e-4), ("x_mm", "x", "m", 0.002), ("x [µm]", "x", "m", 2e-6),
    ("a [m/s²]", "a", "m/s^2", 2.0), ("F [kN]", "F", "N", 2000.0), ("M [Nm]", "M", "N m", 2.0),
    ("M [mN m]", "M", "N m", 0.002), ("duty [%]", "duty", "1", 0.02), ("P_kW", "P", "W", 2000.0),
    ("s [-]", "s", "1", 2.0),
    ("v [km/h]", "v", "m/s", 0.5555556), ("E [J]", "E", "J", 2.0), ("U [mV]", "U", "V", 0.002),
    ("w [rad s^-1]", "w", "rad/s", 2.0),
]  # fmt: skip


@pytest.mark.parametrize(("header", "name", "unit", "two"), HEADERS, ids=[h[0] for h in HEADERS])
def test_a_header_of_any_usual_style_is_read_and_converted(header, name, unit, two):
    said = []
    found = read_recording({"t": [0.0, 1.0], header: [0.0, 2.0]}, told=said.append)
    assert dict(found.units) == {name: unit}
    assert found[name][1] == pytest.approx(two, rel=1e-6)
    changed = two != 2.0
    assert not changed or any(f"{name}: " in line and line.endswith(f" to {unit}") for line in said)


REFUSED = {
    "x [C]": "coulomb or degree Celsius", "m [g]": "gram or the acceleration", "p [bar(g)]": "gauge pressure",
    "L [dB]": "logarithm", "x [foo]": "'foo' is not known", "x": "has no unit", "p_a_bar [psi]": "names two units",
    "x [__import__('os')]": "not known", "x [m^99]": "not known", "T [h]": "an hour or",
    "c [mol/L]": "without a unit here",
}  # fmt: skip


@pytest.mark.parametrize("header", REFUSED)
def test_a_header_with_two_readings_or_none_is_refused_with_what_to_write(header):
    with pytest.raises(InputError, match=REFUSED[header].replace("(", r"\(")):
        read_recording({"t": [0.0, 1.0], header: [0.0, 2.0]})


def test_all_columns_without_a_unit_are_named_at_once_with_the_options_that_tell_it():
    bare = {"t": [0.0, 1.0], "u": [0.0, 2.0], "x [m]": [0.0, 1.0], "y": [0.0, 3.0]}
    with pytest.raises(InputError, match=r"columns u, y: have no unit; .*plain numbers: --unit u=1 --unit y=1"):
        read_recording(bare)
    assert read_recording(bare, units={"u": "1", "y": "1"}).units["y"] == "1"


def test_a_required_unit_is_what_comes(tmp_path):
    csv_house(tmp_path / "record.csv")
    mat5(tmp_path / "v5.mat")
    found = read_recording(tmp_path / "v5.mat", {"p_a": "bar"})
    assert found["p_a"].tolist() == (VALUES["p_a"] * 1e-5).tolist()
    with pytest.raises(InputError, match="cannot be converted to V"):
        read_recording(tmp_path / "v5.mat", {"p_a": "V"})
    with pytest.raises(InputError, match=r"channel q \[V\] is missing"):
        read_recording(tmp_path / "v5.mat", {"q": "V"})


def test_gaps_and_jitter_are_refused_and_resampled_on_request():
    time = TIME + 1e-4 * np.sin(np.arange(N))
    keep = np.r_[0:20, 25:N]
    source = {"t": time[keep], "x [m]": np.sin(20 * time[keep])}
    with pytest.raises(InputError, match="not uniform: 1 gaps, jitter"):
        read_recording(source)
    said = []
    found = read_recording(source, resample=True, told=said.append)
    assert any("1 gaps" in line for line in said)
    assert np.abs(found["x"] - np.sin(20 * (time[0] + found.time))).max() < 5e-3
    slow = read_recording(source, resample=4e-3)
    assert slow.dt == 4e-3


def test_two_clocks_are_told_apart_or_refused():
    with pytest.raises(InputError, match="may both be the time"):
        read_recording({"t": [0.0, 1.0], "time": [0.0, 1.0], "x [m]": [1.0, 2.0]})
    found = read_recording({"t": [0.0, 1.0], "time [s]": [0.0, 2.0], "x [m]": [1.0, 2.0]}, time="t")
    assert found.units == {"time": "s", "x": "m"}
    assert read_recording({"time [ms]": [0.0, 1.0], "x [m]": [1.0, 2.0]}).dt == 1e-3


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("name", [n for n in FORMATS if ".csv" not in n])
@pytest.mark.parametrize("mutants", [4, pytest.param(60, marks=pytest.mark.nightly)])  # a third of a second for each
def test_a_damaged_file_is_refused_in_one_line(name, mutants, tmp_path):
    FORMATS[name](tmp_path / name)
    whole, rng, lines = (tmp_path / name).read_bytes(), np.random.default_rng(1), set()
    for _ in range(mutants):
        data = bytearray(whole)
        for at in rng.integers(0, len(data), 1 + int(rng.integers(8))):
            data[at] = int(rng.integers(256))
        (tmp_path / name).write_bytes(bytes(data[: len(data) - int(rng.integers(2)) * int(rng.integers(len(data)))]))
        try:
            read_recording(tmp_path / name)
        except InputError as error:
            lines.add(str(error).count("\n"))
    assert lines <= {0}


def test_a_unit_is_converted_by_factor_and_zero():
    values, unit = converted(np.array([0.0, 100.0]), "degC", "x")
    assert (values.tolist(), unit) == ([273.15, 373.15], "K")
    assert split("Stellung Kolben [mm]", "x") == ("Stellung_Kolben", "mm")


def test_a_file_without_units_can_be_looked_at_and_is_written_once_they_are_told(tmp_path):
    path = tmp_path / "bare.csv"
    path.write_text("time,pos,vel\n0,1,2\n0.1,2,3\n0.2,3,5\n")
    code, out, told = greygate("look", path, "--json")
    assert code == 0
    assert [c["unit"] for c in json.loads(out)["channels"]] == ["?", "?"]
    assert "no unit is told of pos, vel" in told
    assert greygate("look", path, "--out", tmp_path / "x.csv")[0] == 2
    words = ["--unit", "pos=deg", "--unit", "vel=1", "--out", tmp_path / "x.csv"]
    assert greygate("look", path, *words)[0] == 0
    assert (tmp_path / "x.csv").read_text().startswith("t_s,pos_rad,vel_1\n")


def test_the_page_has_every_sample_of_a_short_channel_to_zoom(tmp_path):
    csv_brackets(tmp_path / "record.csv")
    assert greygate("look", tmp_path / "record.csv", "--html", tmp_path / "page.html")[0] == 0
    page = (tmp_path / "page.html").read_text()
    drawn = [json.loads(text)["traces"] for text in re.findall(r'<script type="application/json">(.*?)</script>', page)]
    assert [list(traces) for traces in drawn] == [[name] for name in VALUES]
    for traces, (name, values) in zip(drawn, VALUES.items(), strict=True):
        shown = unpacked(traces[name]["y"])
        np.testing.assert_allclose(
            shown, {"v_c": 1.0, "x": 1e3, "p_a": 1e-5}[name] * values, atol=traces[name]["y"]["step"]
        )  # V, mm, bar


@pytest.mark.parametrize(("channels", "points"), [(1, POINTS), (30, POINTS // 30)])
def test_a_page_is_below_a_megabyte_and_one_channel_is_as_fine_as_all_may_be(channels, points):
    rng = np.random.default_rng(0)
    time = np.cumsum(rng.uniform(1e-3, 2e-3, 2 * POINTS))
    found = [Channel(f"c{k}", "V", time, rng.uniform(-1, 1, len(time))) for k in range(channels)]
    assert len(recorded.page(found, "a.csv")) < 1_000_000
    assert 0.8 * points < len(unpacked(recorded.drawings(found)["drawn"][0][2]["traces"]["c0"]["y"])) <= points


@pytest.mark.parametrize("size", [1e-300, 1e-160, 1e-323, 1e31, 1e300])
@pytest.mark.parametrize("shape", [[1.0, 2.0, 4.0], [1.0, 1.0, 1.0]])
def test_values_whose_powers_leave_float64_are_refused_where_a_recording_is_read(size, shape, tmp_path):
    values = [size * v for v in shape]
    with pytest.raises(InputError, match=r"channel y goes from .* beyond any quantity"):
        read_recording({"t": [0.0, 1.0, 2.0], "y [m]": values})
    if size < 1:  # a CSV's larger ones are named by their cell
        (tmp_path / "r.csv").write_text("t_s,y_m\n" + "".join(f"{t},{v!r}\n" for t, v in enumerate(values)))
        with pytest.raises(InputError, match=r"channel y goes from .* beyond any quantity"):
            read_recording(tmp_path / "r.csv")
    assert read_recording({"t": [0.0, 1.0, 2.0], "y [m]": [0.0, 1e-29, 1e-300]})["y"][2] == 1e-300


# -- what a file asks for beyond its numbers -------------------------------------------------------------------------


def mdf_formula(path, version, formula):
    """An MDF file whose channel has a formula, as text that no writer would let through."""
    from asammdf import MDF, Signal

    with MDF(version=version) as file:
        mark = "X1+" + "1" * 200
        file.append([Signal(np.arange(5.0), DT * np.arange(5), name="u", unit="V", conversion={"formula": mark})])
        saved = file.save(path.with_suffix(".mf4" if version > "4" else ".mdf"), overwrite=True)
    data = saved.read_bytes()
    at = data.rindex(b"1" * 200) - (3 if version > "4" else 4)
    saved.write_bytes(data[:at] + formula.encode().ljust(200, b" ") + data[at + 200 :])
    saved.rename(path)


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize(("name", "version"), [("a.mf4", "4.10"), ("a.mdf", "3.30"), ("a.dat", "3.30")])
def test_a_formula_in_a_measurement_runs_nothing_and_is_refused_by_the_name_of_its_channel(name, version, tmp_path):
    ran = tmp_path / "ran"
    mdf_formula(tmp_path / name, version, f"X1+__import__('os').system('touch {ran}')+")
    with pytest.raises(InputError, match="'u': its conversion is a formula that is not read"):
        read_recording(tmp_path / name)
    assert not ran.exists()


@pytest.mark.filterwarnings("ignore")
def test_conversions_of_a_measurement_give_the_numbers_that_they_stand_for(tmp_path):
    from asammdf import MDF, Signal

    told = {
        "linear": ({"a": 2.0, "b": 1.0}, lambda x: x * 2.0 + 1.0),
        "rational": (
            {"P1": 1, "P2": 1, "P3": 2, "P4": 0, "P5": 1, "P6": 4},
            lambda x: (x**2 + x + 2) / (0.0 * x**2 + x + 4),
        ),
        "formula": ({"formula": "2 * X1 + sqrt(X1)"}, lambda x: 2 * x + np.sqrt(x)),
        "table": ({"raw_0": 0, "phys_0": 5, "raw_1": 10, "phys_1": 7}, lambda x: np.where(x > 5, 7.0, 5.0)),
        "interpolated": (
            {"raw_0": 0, "phys_0": 5, "raw_1": 10, "phys_1": 7, "interpolation": True},
            lambda x: np.interp(x, [0, 10], [5, 7]),
        ),
        "ranges": (
            {"lower_0": 1, "upper_0": 3, "phys_0": 8, "lower_1": 4, "upper_1": 6, "phys_1": 9, "default": -1},
            lambda x: np.where((x >= 1) & (x <= 3), 8.0, np.where((x >= 4) & (x <= 6), 9.0, -1.0)),
        ),
        "words": ({"val_0": 0, "text_0": b"off", "val_1": 1, "text_1": b"on"}, None),
    }
    raw = np.arange(20, dtype="u2")
    with MDF(version="4.10") as file:
        signals = [Signal(raw, DT * np.arange(20), name=n, unit="V", conversion=c) for n, (c, _) in told.items()]
        file.append(signals)
        file.save(tmp_path / "a.mf4")
    found = read_recording(tmp_path / "a.mf4")
    expected = {n: f(raw.astype(float)).tolist() for n, (_, f) in told.items() if f}
    assert {n: v.tolist() for n, v in found.channels.items()} == expected


@pytest.mark.filterwarnings("ignore")
def test_samples_that_are_flagged_invalid_are_left_out(tmp_path):
    from asammdf import MDF, Signal

    bad = np.arange(N) == 7
    with MDF(version="4.10") as file:
        file.append([Signal(VALUES["x"], TIME, name="x", unit="m", invalidation_bits=bad)])
        file.save(tmp_path / "a.mf4")
    (found,) = read_channels(tmp_path / "a.mf4")
    assert found.values.tolist() == VALUES["x"][~bad].tolist()
    assert found.time.tolist() == TIME[~bad].tolist()


@pytest.mark.filterwarnings("ignore")
def test_channels_over_an_angle_are_no_recording_over_time(tmp_path):
    from asammdf import MDF, Signal

    with MDF(version="4.10") as file:
        file.append([Signal(VALUES["x"], TIME, name="x", unit="m", master_metadata=("phi", 2))])
        file.save(tmp_path / "a.mf4")
    with pytest.raises(InputError, match="'phi': the channels beside it are over an angle, not time"):
        read_recording(tmp_path / "a.mf4")
    with MDF(version="4.10") as file:
        file.append([Signal(VALUES["x"], TIME, name="x", unit="m")])
        file.groups[0].channels[0].flags |= 1
        file.save(tmp_path / "b.mf4")
    with pytest.raises(InputError, match="'time': is a time that is flagged invalid"):
        read_recording(tmp_path / "b.mf4")


def test_waveforms_that_start_apart_stay_apart(tmp_path):
    from nptdms import ChannelObject, TdmsWriter

    begin = np.datetime64("2026-01-01T00:00:00.000000")
    with TdmsWriter(tmp_path / "a.tdms") as writer:
        writer.write_segment(
            [
                ChannelObject(
                    "run", n, VALUES[n], {"wf_increment": DT, "wf_start_time": start, "unit_string": UNITS[n]}
                )
                for n, start in {"v_c": begin, "x": begin + np.timedelta64(20, "ms")}.items()
            ]
        )
    first, second = read_channels(tmp_path / "a.tdms")
    assert (first.time[0], second.time[0]) == (0.0, pytest.approx(0.02, abs=1e-9))
    with pytest.raises(InputError, match="different times"):
        read_recording(tmp_path / "a.tdms")


def test_times_since_an_epoch_keep_the_grid_of_their_samples(tmp_path):
    import pyarrow
    import pyarrow.parquet
    from mcap.writer import Writer

    stamps = 1_790_000_000_000_000_000 + 100_000 * np.arange(N)
    with open(tmp_path / "a.mcap", "wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel("/rig", "json", writer.register_schema("sample", "jsonschema", b"{}"))
        for at in stamps.tolist():
            writer.add_message(channel, at, b'{"x_m": 1.0}', at)
        writer.finish()
    columns = {"t [ns]": stamps, "x [m]": VALUES["x"]}
    pyarrow.parquet.write_table(pyarrow.table(columns), tmp_path / "a.parquet")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["time"], file["x_m"] = stamps // 1000, VALUES["x"]
        file["time"].attrs["units"] = "microseconds since 1970-01-01"
    for name in ("a.mcap", "a.parquet", "a.h5"):
        assert read_recording(tmp_path / name).dt == 1e-4


def test_packed_and_missing_values_of_netcdf_are_what_its_attributes_say(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["t"] = TIME
        stored = file.create_dataset("p", data=np.arange(N, dtype="i2"))
        stored.attrs.update({"scale_factor": 0.5, "add_offset": 10.0, "units": "Pa", "_FillValue": np.int16(-1)})
    assert read_recording(tmp_path / "a.h5")["p"].tolist() == (np.arange(N) * 0.5 + 10.0).tolist()
    with h5py.File(tmp_path / "a.h5", "r+") as file:
        file["p"][9] = -1
    with pytest.raises(InputError, match="sample 9 has the value nan"):
        read_recording(tmp_path / "a.h5")


@pytest.mark.parametrize(
    ("stored", "fill", "told"),
    [
        ([1, 2, 999], None, {"valid_range": [0, 100]}), ([1, 2, -32767], -32767, {}),
        ([1, 2, 9], None, {"valid_range": 3}),
    ],
)  # fmt: skip
def test_a_sample_that_netcdf_calls_missing_by_its_range_or_by_default_is_no_number(stored, fill, told, tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["t"] = [0.0, 0.1, 0.2]
        file.create_dataset("p_Pa", data=np.array(stored, "i2"), fillvalue=fill).attrs.update(told)
    with pytest.raises(InputError, match=r"sample 2 has the value nan|valid_range is no pair"):
        read_recording(tmp_path / "a.h5")


def test_objects_and_sparse_matrices_of_matlab_are_left_out_as_their_places_are_no_samples(tmp_path):
    with h5py.File(tmp_path / "a.mat", "w", userblock_size=512) as file:
        file["t"], file["x_m"] = [TIME], [VALUES["x"]]
        file["s/data"], file["s/ir"], file["s/jc"] = [VALUES["x"]], np.arange(N), [0, N]
        file["s"].attrs.update({"MATLAB_class": np.bytes_("double"), "MATLAB_sparse": np.uint64(N)})
        file["d"] = np.arange(6, dtype="u4")[None]
        file["d"].attrs.update({"MATLAB_class": np.bytes_("datetime"), "MATLAB_object_decode": 3})
    with open(tmp_path / "a.mat", "r+b") as block:
        block.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    assert read_mat(tmp_path / "a.mat").keys() == {"t", "x_m"}
    assert read_recording(tmp_path / "a.mat").channels.keys() == {"x"}


@pytest.mark.parametrize("place", ["channel", "group"])
def test_a_scale_of_tdms_that_is_not_computed_is_refused_by_name(place, tmp_path):
    from nptdms import ChannelObject, GroupObject, TdmsWriter

    scale = {"NI_Number_Of_Scales": np.int32(1), "NI_Scale[0]_Scale_Type": "Reciprocal"}
    for status in ("unscaled", "scaled"):
        told = {**scale, "NI_Scaling_Status": status}
        wave = {"wf_increment": DT, "unit_string": "m", **(told if place == "channel" else {})}
        with TdmsWriter(tmp_path / "a.tdms") as writer:
            group = GroupObject("run", told if place == "group" else {})
            writer.write_segment([group, ChannelObject("run", "x", VALUES["x"], wave)])
        if status == "scaled":
            assert read_recording(tmp_path / "a.tdms")["x"].tolist() == VALUES["x"].tolist()
        else:
            with pytest.raises(InputError, match="'x': has the scale 'Reciprocal', which is not known"):
                read_recording(tmp_path / "a.tdms")


def test_memory_that_is_refused_without_a_limit_of_the_computer_is_named(tmp_path):
    from nptdms import ChannelObject, TdmsWriter

    with TdmsWriter(tmp_path / "a.tdms") as writer:  # nptdms makes a list of so many
        told = {"NI_Number_Of_Scales": np.int32(2**31 - 1), "wf_increment": DT}
        writer.write_segment([ChannelObject("run", "x", VALUES["x"], told)])
    with pytest.raises(InputError, match=r"needs more memory than the [1-9]\d* MiB"):
        read_recording(tmp_path / "a.tdms")


def messages(path, said):
    """An MCAP file of (topic, time in ms, message)."""
    from mcap.writer import Writer

    with open(path, "wb") as file:
        writer = Writer(file)
        writer.start()
        topics = {topic: writer.register_channel(topic, "json", 0) for topic, *_ in said}
        for topic, at, told in said:
            writer.add_message(topics[topic], at * 1_000_000, json.dumps(told).encode(), 0)
        writer.finish()


def test_a_channel_t_that_is_no_time_stays_and_two_of_one_name_are_refused(tmp_path):
    messages(tmp_path / "a.mcap", [("rig", k, {"T": 20.0 + k, "time": 5.0 + k, "x": k}) for k in range(N)])
    found = read_recording(tmp_path / "a.mcap", units={"T": "degC", "x": "m"})
    assert found["T"].tolist() == (273.15 + 20.0 + np.arange(N)).tolist()
    assert found.channels.keys() == {"T", "x"}
    messages(tmp_path / "b.mcap", [("rig", k, {"t": 20.0 - k, "x": k}) for k in range(N)])
    with pytest.raises(InputError, match="columns t, x: have no unit"):
        read_recording(tmp_path / "b.mcap")
    twice = [(topic, k, told) for k in range(N) for topic, told in (("a/b", {"c": k}), ("a", {"b/c": -k}))]
    messages(tmp_path / "c.mcap", twice)
    with pytest.raises(InputError, match="two of its channels or variables are called 'a/b/c'"):
        read_recording(tmp_path / "c.mcap")


@pytest.mark.parametrize(("header", "read"), [("t", read_recording), ("timestamp", read_channels)])
def test_a_time_since_an_epoch_is_in_no_unit_but_the_told_one(header, read, tmp_path):
    path = tmp_path / "a.csv"
    path.write_text(f"{header},x_m\n" + "".join(f"{1_790_000_000_000 + k},{k}\n" for k in range(9)))
    with pytest.raises(InputError, match=f"time {header} begins at 1.79e\\+12 and has no unit"):
        read(path)
    assert read_recording(path, units={header: "ms"}).dt == 1e-3


@pytest.mark.parametrize(
    ("header", "unit", "name", "least"),
    [
        ("x_mm", "m", None, 0), ("x [bar]", "Pa", None, 0), ("T_deg", "degC", None, 0), ("x_m", "m", "x", 1.0),
        ("x_1", "mm", "x_1", 1e-3), ("p_A", "bar", "p_A", 1.0), ("n_rpm", "1/min", "n", np.pi / 30),
    ],
)  # fmt: skip
def test_a_unit_in_the_header_and_another_apart_from_it_are_refused(header, unit, name, least, tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["t"], file[header] = TIME, np.arange(1.0, N + 1)
        file[header].attrs["unit"] = unit
    if name is None:
        with pytest.raises(InputError, match="names two units"):
            read_recording(tmp_path / "a.h5")
    else:
        assert {n: v[0] for n, v in read_recording(tmp_path / "a.h5").channels.items()} == {name: pytest.approx(least)}


@pytest.mark.parametrize("ending", ["mcap", "parquet"])
def test_a_value_that_its_own_checksum_denies_is_not_read(ending, tmp_path):
    import pyarrow
    import pyarrow.parquet
    from mcap.writer import CompressionType, Writer

    path, values = tmp_path / f"a.{ending}", np.arange(N) + 1000.125
    if ending == "parquet":
        table = pyarrow.table({"t": TIME, "x_m": values})
        pyarrow.parquet.write_table(table, path, use_dictionary=False, compression="none", write_page_checksum=True)
    else:
        with open(path, "wb") as file:
            writer = Writer(file, compression=CompressionType.NONE)
            writer.start()
            topic = writer.register_channel("rig", "json", 0)
            for k, value in enumerate(values):
                writer.add_message(topic, k * 1_000_000, json.dumps({"x_m": value}).encode(), 0)
            writer.finish()
    assert read_recording(path)["x"].tolist() == values.tolist()
    whole, sign = path.read_bytes(), values[7].tobytes() if ending == "parquet" else b"1007.125"
    path.write_bytes(whole.replace(sign, b"9" * 8))
    with pytest.raises(InputError, match=r"cannot be read .*(?i:crc)"):
        read_recording(path)


def test_complex_numbers_are_refused_by_name(tmp_path):
    values = np.exp(1j * TIME)
    savemat(tmp_path / "a.mat", {"t": TIME, "z_V": values})
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["t"], file["z_V"] = TIME, values
    for name in ("a.mat", "a.h5"):
        with pytest.raises(InputError, match="z_V: holds complex numbers"):
            read_recording(tmp_path / name)


def _external(file, secret):
    file.create_dataset("x_m", (N,), "f8", external=[(str(secret), 0, 8 * N)])


def _virtual(file, secret):
    layout = h5py.VirtualLayout((N,), "f8")
    layout[:] = h5py.VirtualSource(str(secret), "x", (N,))
    file.create_virtual_dataset("x_m", layout)


def _linked(file, secret):
    file["x_m"] = h5py.ExternalLink(str(secret), "x")


def _softly(file, secret):
    file["deep/out"] = h5py.ExternalLink(str(secret), "/")
    file["x_m"] = h5py.SoftLink("/deep/out/x")


@pytest.mark.parametrize("outside", [_external, _virtual, _linked, _softly])
@pytest.mark.parametrize("ending", [".h5", ".mat"])
def test_data_that_lie_in_another_file_are_never_read(outside, ending, tmp_path):
    secret = tmp_path / "secret"
    with h5py.File(secret, "w") as file:
        file["x"] = VALUES["x"]
    path = tmp_path / f"a{ending}"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["t"] = TIME
        outside(file, secret)
    with open(path, "r+b") as block:
        block.write(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM")
    with pytest.raises(InputError, match=r"'(x_m|out)' (keeps its data in other files|is a link to another file)"):
        read_recording(path)


def test_a_small_file_that_unpacks_to_much_is_refused_before_it_is_unpacked(tmp_path):
    import pyarrow
    import pyarrow.parquet

    zeros = np.zeros(20_000_000)
    pyarrow.parquet.write_table(pyarrow.table({"t": zeros}), tmp_path / "a.parquet")
    savemat(tmp_path / "a.mat", {"t": zeros}, do_compression=True)
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("t", (10**12,), "f8", chunks=(1000,))
    for name in ("a.parquet", "a.mat", "a.h5"):
        with pytest.raises(InputError, match=r"unpacks to more than 128 MiB, by 't' to [0-9]+ MiB"):
            read_recording(tmp_path / name)


def test_groups_that_hold_one_another_end(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        group = file.create_group("g")
        for k in range(10):
            group[f"g{k}"] = group
    with pytest.raises(InputError, match="holds more than 20000 channels"):
        read_recording(tmp_path / "a.h5")


@checking.POSIX
def test_a_limit_of_memory_that_is_there_is_kept_and_named(tmp_path):
    savemat(tmp_path / "a.mat", {"t": TIME, "x_m": VALUES["x"]})
    code = (
        "import resource, sys; from greygate.plants import read_csv; from greygate.plants.readers.read import *\n"
        "most = int(sys.argv[2]) << 20; resource.setrlimit(resource.RLIMIT_AS, (most, most))\n"
        "print(read_recording(sys.argv[1]))"
    )
    said = {}
    for most in (4000, 120):
        command = [sys.executable, "-c", code, tmp_path / "a.mat", str(most)]
        said[most] = subprocess.run(command, capture_output=True, text=True)
    assert said[4000].stdout.startswith("<Recording")
    assert "memory" in said[120].stderr
    assert "damaged" not in said[120].stderr


def test_what_reads_a_file_runs_no_code_and_opens_no_other(tmp_path):
    code = (
        "import sys; from pathlib import Path; from greygate.foreign import child\n"
        "def reader():\n"
        "    def read(path, room):\n"
        "        try: exec(sys.argv[3])\n"
        "        except Exception: pass\n"
        "        yield 'x', 'text'\n"
        "    return read\n"
        "sys.exit(child.served({'x': reader}, 'x', sys.argv[1], sys.argv[2]))"
    )
    (tmp_path / "a").touch()
    trusted = {**os.environ, "GREYGATE_UNLIMITED": "1"}  # on a system without limits it is locked all the same
    for asked in ("1", f"open({str(tmp_path / 'b')!r}, 'w')", "__import__('os').system('true')"):
        done = subprocess.run(
            [sys.executable, "-c", code, tmp_path / "a", tmp_path, asked],
            capture_output=True, text=True, env=trusted,
        )  # fmt: skip
        assert (done.returncode, done.stdout) == (3, "asks for code to be run; what a file says is never run\n")
    assert not (tmp_path / "b").exists()


@pytest.mark.parametrize("said", ["return without exception set", "returned NULL without setting an exception"])
def test_a_reader_that_has_no_memory_left_to_say_so_is_told_from_a_damaged_file(tmp_path, said):
    code = (
        "import sys; from greygate.foreign import child\n"
        "def reader():\n"
        "    raise SystemError(sys.argv[3])\n"
        "sys.exit(child.served({'x': reader}, 'x', sys.argv[1], sys.argv[2]))"
    )
    (tmp_path / "a").touch()
    done = subprocess.run([sys.executable, "-c", code, tmp_path / "a", tmp_path, said], capture_output=True, text=True)
    assert done.returncode == child.MEMORY
    assert "that reading it may take" in done.stdout


def test_what_is_not_read_is_said(tmp_path, greygate):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for name, values in {"t": 0.01 * np.arange(9), "u": np.arange(9.0), "q": np.zeros((9, 2))}.items():
            file[name] = values
            file[name].attrs["unit"] = "s" if name == "t" else "V"
        file.create_group("sub")["w"] = np.arange(9.0)
    code, out, error = greygate("look", tmp_path / "a.h5")
    assert (code, "u " in out) == (0, True)
    assert error == f"{tmp_path / 'a.h5'}: left out: q (9 x 2), sub (a group)\n"
    pyarrow, parquet = pytest.importorskip("pyarrow"), importlib.import_module("pyarrow.parquet")
    table = pyarrow.table({"t": 0.01 * np.arange(9), "u [V]": np.arange(9.0), "note": ["a"] * 9})
    parquet.write_table(table, tmp_path / "a.parquet")
    assert greygate("look", tmp_path / "a.parquet")[2] == f"{tmp_path / 'a.parquet'}: left out: note (string)\n"


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"t": 0.01 * np.arange(9), "n [1]": (1 << 53) + np.arange(1, 10)}, "column n: integers beyond 2^53"),
        ({"t": 0.01 * np.arange(9), "n [1]": np.arange(9, dtype=np.uint64) + np.uint64(1 << 63)}, "beyond 2^53"),
        ({"time": 45352.5 + np.arange(9) / 8.64e6, "u [V]": np.arange(9.0)}, "seems to count days; tell its unit"),
    ],
)
def test_what_a_float_or_a_second_cannot_hold_is_refused(columns, message):
    with pytest.raises(InputError, match=re.escape(message)):
        read_recording(columns)


def test_a_unit_that_is_told_is_of_the_whole_header_and_a_times_own_is_read(tmp_path):
    read = read_recording({"t_ms": 10.0 * np.arange(9), "phi_m": np.arange(9.0)}, units={"phi_m": "deg"})
    assert (read.dt, [*read.channels], read["phi_m"][1]) == (0.01, ["phi_m"], pytest.approx(np.pi / 180))
    assert [*read_recording({"t": np.arange(9.0), "phi_m": np.arange(9.0)}).units.items()] == [("phi", "m")]
    (tmp_path / "a.csv").write_text("time_ms,u_V\n" + "".join(f"{20 * k},{k}\n" for k in range(9)))
    assert read_recording(tmp_path / "a.csv").dt == 0.02
