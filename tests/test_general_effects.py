"""General effects on plants of a user: where they are offered, in which size and unit, and what they do."""

from dataclasses import replace

import numpy as np
import pytest
from small_plants import write
from test_shapes import play, rig_of

from greygate.mismatch import effects as table
from greygate.mismatch import filters, places
from greygate.mismatch.diagnose import diagnose
from greygate.mismatch.model import Model
from greygate.mismatch.rig import load
from greygate.mismatch.seen import Seen
from greygate.plants import Plant, simulate, units
from greygate.plants.expressions import parse

DT = 5e-3
MOTOR = """
step = 1e-3
outputs = ["omega"]
inputs = { voltage = "V" }
[parameters]
inertia = [1e-3, "kg m^2"]
k = [0.1, "N m/A"]
resistance = [1.0, "Ohm"]
viscous = [1e-3, "N m s/rad"]
[states]
omega = { unit = "rad/s" }
[definitions.current]
i = { unit = "A", ohm = "(voltage - k * omega) / resistance" }
[equations.motion]
omega = { storage = "inertia", motor = "k * i", viscous = "-viscous * omega" }
"""
TANKS = """
step = 5e-3
outputs = ["a", "b"]
inputs = { q = "m^3/s" }
[parameters]
area = [0.02, "m^2"]
out = [0.01, "m^2/s"]
[states]
a = { unit = "m", initial = 0.5 }
b = { unit = "m", initial = 0.5 }
[equations.first]
a = { storage = "area", inflow = "q", outflow = "-out * a" }
[equations.second]
b = { storage = "area", inflow = "0.01", outflow = "-out * b" }
"""
TWO = """
step = 1e-3
outputs = ["x", "y"]
inputs = { force = "N" }
[parameters]
mass = [1.0, "kg"]
k = [40.0, "N/m"]
[states]
x = { unit = "m", rate = "v" }
v = { unit = "m/s" }
y = { unit = "m", rate = "w" }
w = { unit = "m/s" }
[equations]
place_x.x = { velocity = "v" }
body.v = { storage = "mass", drive = "force", spring = "-k * x" }
place_y.y = { velocity = "w" }
tail.w = { storage = "mass", spring = "-k * y", pull = "0.1 * force" }
"""
IMPOSED = """
step = 5e-3
outputs = ["f"]
inputs = { x = "m", v = "m/s" }
[parameters]
k = [40.0, "N/m"]
[states]
[equations]
[derived]
v = "smooth_rate x"
[definitions.force]
f = { unit = "N", spring = "k * x" }
"""
PLANTS = {
    "motor": (MOTOR, {"voltage": "V"}, {"omega": "rad/s"}, {"viscous": 1e-3}),
    "tanks": (TANKS, {"q": "m^3/s"}, {"a": "m", "b": "m"}, {"out": 0.01}),
    "two": (TWO, {"force": "N"}, {"x": "m", "y": "m"}, {"k": 40.0}),
    "imposed": (IMPOSED, {"x": "m"}, {"f": "N"}, {"k": 40.0}),
}


def steps(samples: int, seed: int = 5) -> np.ndarray:
    """Random steps of unit size, of 60 samples each."""
    return np.repeat(np.random.default_rng(seed).standard_normal(-(-samples // 60)), 60)[:samples]


def made(folder, name: str, samples: int = 1200, lift: float = 0.0, change=lambda plant: plant, after=lambda s: s,
         noise: float = 0.0):  # fmt: skip
    """The rig of a plant in `folder`. lift: of its input. change: the real plant. after: recorded channels.

    noise: RMS, told; without it that of a thousandth of the range, and not told.
    """
    text, inputs, outputs, sheet = PLANTS[name]
    folder.mkdir(exist_ok=True)
    (folder / "plant.toml").write_text(text)
    rig = f'plant = "plant.toml"\nsample_time_s = {DT}\npredict = {[*outputs]}\n'.replace("'", '"')
    rig += "[parameters]\n" + "".join(f"{s} = {v}\n" for s, v in sheet.items())
    rig += "[tolerance]\n" + "".join(f"{s} = 0.2\n" for s in sheet)
    for role, channels in (("input", inputs), ("output", outputs)):
        told = f"noise_rms = {noise}\n" if noise and role == "output" else ""
        rig += "".join(f'[channels.{c}]\nunit = "{u}"\nrole = "{role}"\n{told}' for c, u in channels.items())
    (folder / "rig.toml").write_text(rig)
    plant = change(Plant.read(folder / "plant.toml"))
    size = {"voltage": 6.0, "q": 0.01, "force": 3.0, "x": 0.1}
    given = {c: size[c] * (steps(samples) + lift) for c in inputs}
    if name == "imposed":
        given = {"x": 0.1 * np.sin(np.arange(samples) * DT * 5.0), "v": 0.5 * np.cos(np.arange(samples) * DT * 5.0)}
    recorded = simulate(plant, given, sample_time=DT, step=plant.step)
    rng = np.random.default_rng(2)
    columns = {c: given[c] for c in inputs}
    columns |= {c: recorded[c] + (noise or 1e-3 * np.ptp(recorded[c])) * rng.standard_normal(samples) for c in outputs}
    columns = after(columns)
    csv = np.column_stack([np.arange(samples) * DT, *columns.values()])
    np.savetxt(folder / "identify.csv", csv, delimiter=",", header=",".join(["t", *columns]), comments="", fmt="%.10g")
    return load(folder)


@pytest.fixture(scope="module")
def rigs(tmp_path_factory):
    folder = tmp_path_factory.mktemp("rigs")
    return {name: made(folder / name, name) for name in PLANTS}


def recording(rig):
    return rig.recording(rig.folder / "identify.csv")


@pytest.mark.parametrize("name", PLANTS)
def test_each_does_nothing_at_null_and_something_at_its_typical_size(name, rigs):
    rig = rigs[name]
    effects = table.general(rig, recording(rig))
    model, bare = (Model(rig, recording(rig), e) for e in (effects, {}))
    base = model.predict(model.values)
    np.testing.assert_array_equal(base, bare.predict(bare.values))
    still = []
    for key, effect in effects.items():
        change = np.zeros(base.shape[1])
        for pick in (0, -1):
            own = {f.symbol: f.guess[pick] if f.guess else f.typical for f in effect.free}
            change += np.abs(model.predict({**model.values, **own}) - base).max(axis=0)
        assert np.isfinite(change).all(), key
        if not (change > 1e-9 * np.ptp(base, axis=0)).any():
            still.append(key)
    assert still in ([], ["input_play"])  # a play of a tenth of a step that comes in steps


OFFERED = {
    "motor": {"dry_friction": ("f_omega", "N m"), "square_damping": ("c2_omega", "N m s^2/rad^2"),
              "late_channel": ("omega_late", "s"), "input_dead_zone": ("voltage_dead", "V"),
              "load_friction": ("mu_omega", "1"),
              "dry_friction_elastic": ("f_omega_yield", "rad")},
    "tanks": {"square_leak_a": ("leak2_a", "m/s"), "exchange": ("flow_a_b", "m^2/s"),
              "source_b": ("source_b", "m^3/s")},
    "two": {"spring_between": ("k_x_y", "N/m"), "friction_between": ("f_v_w", "N"),
            "direction_friction_between": ("d_v_w", "N s/m"), "load_friction_x": ("mu_v", "1"),
            "viscous_friction_y": ("c_w", "N s/m"), "hardening_spring_x": ("k3_x", "N/m^3")},
    "imposed": {"dry_friction": ("f_v", "N"), "viscous_friction": ("c_v", "N s/m")},
}  # fmt: skip


@pytest.mark.parametrize("name", PLANTS)
def test_effects_take_places_and_units_of_the_plant(name, rigs):
    rig = rigs[name]
    effects = table.general(rig, recording(rig))
    assert not {"sensor_drift", "input_fading", "growing_load"} & set(effects)  # where no noise is told
    for key, (symbol, unit) in OFFERED[name].items():
        assert {f.symbol: f.unit for f in effects[key].free}[symbol] == unit
    assert all(f.unit for e in effects.values() for f in e.free)


def test_a_term_that_the_data_sheet_leaves_uncertain_is_not_offered_again(rigs):
    assert "viscous_friction" not in table.general(rigs["motor"], recording(rigs["motor"]))
    assert {"spring_x", "viscous_friction_x"} & set(table.general(rigs["two"], recording(rigs["two"]))) == {
        "viscous_friction_x"
    }


def test_a_load_that_inputs_bring_through_a_definition_makes_friction(rigs):
    rig = rigs["motor"]
    (term,) = table.general(rig, recording(rig))["load_friction"].terms.values()
    assert "abs((k*i))" in term  # i is defined by the voltage


def test_what_a_mass_matrix_couples_are_not_two_bodies(rigs):
    plant = rigs["two"].plant
    second = replace(plant.equations["tail"], couples={"v": "0.1"})
    coupled = replace(plant, equations=plant.equations | {"tail": second})
    found, apart = (places.places(replace(rigs["two"], plant=p)) for p in (coupled, plant))
    assert len(apart["bodies"]) == len(apart["springs"]) == 1
    assert found["bodies"] == found["springs"] == []
    assert len(found["v"]) == 2


def test_a_play_is_in_what_links_two_bodies_by_how_far_they_are_apart(tmp_path):
    rig = rig_of(tmp_path / "rig", play)
    plant = rig.plant

    def links(shaft):
        definition = replace(plant.definitions["coupling"], terms={"spring": shaft})
        return places.places(replace(rig, plant=replace(plant, definitions={"coupling": definition})))["links"]

    (link,) = links("k * (q_m - q_l) + d * (w_m - w_l)")
    values = {"k": 30.0, "d": 0.1, "q_m": 0.5, "q_l": 0.1, "w_m": 2.0, "w_l": 1.0, "play_q_m_q_l": 0.0}

    def torque(side, apart):
        return [parse(link[f"{side}_{i}"]).over(values | {"play_q_m_q_l": apart}) for i in (1, 2)]

    assert torque("link", 0.0) == torque("slack", 0.0) == pytest.approx([-12.1, 12.1])
    assert torque("slack", 0.3) == pytest.approx([-3.1, 3.1])
    assert torque("slack", 0.5) == pytest.approx([0.0, 0.0])
    assert links("k * (q_m - 2 * q_l)") == []  # a gear between them: they are not two ends of a spring
    assert links("k * q_m") == []


def test_what_the_rigs_own_table_has_is_not_offered_under_a_second_name(rigs):
    rig = rigs["tanks"]
    free = (table.Free("c_pipe", 1.0),)
    both = {"first.pipe": "-c_pipe * (a - b)", "second.pipe": "c_pipe * (a - b)"}
    pipe = table.Effect("pipe", "", ("plant",), ("first", "second"), (), free, both)
    one = table.Effect("one", "", ("plant",), ("first",), (), free, {"first.pipe": both["first.pipe"]})
    assert "exchange" in table.general(rig, recording(rig), [one])
    assert "exchange" not in table.general(rig, recording(rig), [pipe])
    assert "exchange" in table.general(rig, recording(rig), [pipe], every=True)  # another recording may have told them


def test_what_the_rigs_own_table_has_in_another_shape_is_not_offered_under_a_second_name(rigs):
    rig = rigs["motor"]
    (speed,) = (f for f in table.general(rig, recording(rig))["dry_friction"].free if f.shape)
    for width, twin in ((1.1 * speed.guess[0], True), (100.0 * speed.guess[-1], False)):
        term = {"motion.rub": f"-rub * tanh(omega / {width!r})"}
        rub = table.Effect("rub", "", ("plant",), ("motion",), ("v",), (table.Free("rub", 1.0, low=0.0),), term)
        assert ("dry_friction" not in table.general(rig, recording(rig), [rub])) is twin


def test_in_a_definition_friction_may_have_either_sign(rigs):
    for name, symbol, low in (("imposed", "f_v", -np.inf), ("motor", "f_omega", 0.0)):
        effect = table.general(rigs[name], recording(rigs[name]))["dry_friction"]
        assert {f.symbol: f.low for f in effect.free}[symbol] == low


def test_a_channel_that_nothing_else_is_recorded_beside_is_never_late(rigs):
    rig = rigs["motor"]
    assert "late_channel" in table.general(rig, recording(rig))
    alone = replace(rig, channels={name: rig.channels[name] for name in rig.predict})
    assert (
        Seen(alone, recording(rig)).lacks(["beside omega"]) == "there is no input, and no other channel, beside omega"
    )


def test_what_a_recording_cannot_excite_is_not_offered_and_can_still_be_simulated(tmp_path):
    rig = made(tmp_path / "motor", "motor", lift=9.0)  # the motor turns one way
    offered = table.general(rig, recording(rig))
    idle = {"input_dead_zone", "input_asymmetry", "direction_friction", "line_pickup"}
    assert not idle & set(offered)
    assert idle <= set(table.general(rig, recording(rig), every=True))


def test_sizes_go_with_the_units_of_the_plant(rigs, tmp_path):
    """The same motor in mV and mA: every size is a thousand times as large, or none."""
    text, *_ = PLANTS["motor"]
    one = {f.symbol: f.typical for e in table.general(rigs["motor"], recording(rigs["motor"])).values() for f in e.free}
    scaled = text.replace("(voltage - k * omega)", "(voltage / 1000.0 - k * omega)").replace('"V"', '"mV"')
    rig = made(tmp_path / "motor", "motor")
    (rig.folder / "plant.toml").write_text(scaled)
    (rig.folder / "rig.toml").write_text((rig.folder / "rig.toml").read_text().replace('"V"', '"mV"'))
    columns = np.loadtxt(rig.folder / "identify.csv", delimiter=",", skiprows=1)
    columns[:, 1] *= 1000.0
    np.savetxt(rig.folder / "identify.csv", columns, delimiter=",", header="t,voltage,omega", comments="")
    rig = load(rig.folder)
    other = {f.symbol: (f.typical, f.unit) for e in table.general(rig, recording(rig)).values() for f in e.free}
    assert set(other) == set(one)
    for symbol, (typical, unit) in other.items():
        assert typical == pytest.approx(one[symbol] * (1000.0 if unit.startswith("mV") else 1.0), rel=1e-6), symbol


def test_a_line_is_found_where_it_is_and_nowhere_else(rigs, tmp_path):
    assert "line_pickup" not in table.general(rigs["motor"], recording(rigs["motor"]))
    hum = 1.5 * np.sin(2 * np.pi * 49.93 * np.arange(1200) * DT)
    rig = made(tmp_path / "hum", "motor", after=lambda columns: columns | {"omega": columns["omega"] + hum})
    guess = next(f.guess for f in table.general(rig, recording(rig))["line_pickup"].free if f.guess)
    assert guess[0] == pytest.approx(49.93, abs=2e-3)


@pytest.mark.parametrize("hum", [0.0, 2e-3])
def test_a_machines_own_swing_is_no_line(tmp_path, hum):
    """A pendulum that swings freely, its angle large enough for a third harmonic; perhaps with pickup at 7.3 Hz."""
    plant = """step = 2e-3
outputs = ["phi"]
states = { phi = { unit = "rad", initial = 1.2, rate = "w" }, w = { unit = "rad/s" } }
parameters = { rate = [25.0, "1/s^2"], drag = [0.02, "1/s"] }
[equations]
angle.phi = { speed = "w" }
swing.w = { weight = "-rate * sin(phi)", drag = "-drag * w" }
"""
    phi, w, found = 1.2, 0.0, []
    for _ in range(1500):
        found.append(phi)
        for _ in range(20):
            w += 1e-3 * (-25.4 * np.sin(phi) - 0.02 * w)
            phi += 1e-3 * w
    rng, t = np.random.default_rng(1), 0.02 * np.arange(1500)
    read = np.array(found) + 1e-3 * rng.standard_normal(1500) + hum * np.sin(2 * np.pi * 7.3 * t)
    channels = {"phi": ("rad", "output", 1e-3, read)}
    rig = load(write(tmp_path / "rig", plant, {"rate": 25.0, "drag": 0.02}, {"rate": 0.05}, channels, 0.02))
    lines = [line for line in Seen(rig, rig.to_explain()).lines("phi") if line < 45.0]
    assert lines == ([pytest.approx(7.3, abs=2e-2)] if hum else [])


def test_dry_friction_is_named_where_only_speed_is_measured(tmp_path):
    def real(plant):
        return plant.with_term("motion", "dry", "-0.05 * tanh(omega / 0.5)")

    rig = made(tmp_path / "motor", "motor", change=real)
    effects = table.general(rig, recording(rig))
    some = ("dry_friction", "dry_friction_static", "input_dead_zone", "input_offset", "square_damping", "sensor_offset")
    found = diagnose(rig, effects={key: effects[key] for key in some}).as_dict()
    assert [e["id"] for e in found["effects"]] == ["dry_friction"]
    low, high = found["effects"][0]["parameters"]["f_omega"]["ci95"]
    assert 0.04 < low < 0.05 < high < 0.06


ROOM = """
step = 60.0
outputs = ["room"]
inputs = { heat = "W", out = "degC" }
[parameters]
capacity = [4e5, "J/K"]
loss = [60.0, "W/K"]
[states]
room = { unit = "degC", initial = 18.0 }
[equations.air]
room = { storage = "capacity", heat = "heat", loss = "-loss * (room - out)" }
"""
WALL = """
[states]
room = { unit = "degC", initial = 18.0 }
wall = { unit = "degC", initial = 18.0 }
[equations.air]
room = { storage = "capacity", heat = "heat", loss = "-loss * (room - out)", wall = "-40.0 * (room - wall)" }
[equations.wall]
wall = { storage = "2e6", air = "40.0 * (room - wall)" }
"""


def test_a_wall_that_stores_heat_is_named_and_begins_as_warm_as_the_room(tmp_path):
    """Free run: what the effect brings begins as it says there, too."""
    rng, t = np.random.default_rng(1), np.arange(600) * 300.0
    heat, out = 1500.0 * np.repeat(rng.random(25) > 0.5, 24), 5 + 4 * np.sin(2 * np.pi * t / 86400)
    (tmp_path / "plant.toml").write_text(ROOM)
    (tmp_path / "wall.toml").write_text(ROOM.partition("[states]")[0] + WALL.lstrip())
    room = simulate(Plant.read(tmp_path / "wall.toml"), {"heat": heat, "out": out}, sample_time=300.0, step=60.0)[
        "room"
    ]
    columns = np.column_stack([t, heat, out, room + 0.03 * rng.standard_normal(len(t))])
    np.savetxt(tmp_path / "identify.csv", columns, delimiter=",", header="t,heat,out,room", comments="", fmt="%.10g")
    (tmp_path / "rig.toml").write_text(
        'plant = "plant.toml"\nsample_time_s = 300.0\npredict = ["room"]\n'
        "parameters = { capacity = 4e5, loss = 60.0 }\ntolerance = { capacity = 0.1, loss = 0.1 }\n"
        '[channels]\nheat = { unit = "W", role = "input" }\nout = { unit = "degC", role = "input" }\n'
        'room = { unit = "degC", role = "output", noise_rms = 0.03 }\n'
    )
    rig = load(tmp_path)
    known = table.known(rig, rig.to_explain())
    found = diagnose(rig, effects={key: known[key] for key in ("hidden_storage", "leak", "input_lag_heat")}).as_dict()
    assert [effect["id"] for effect in found["effects"]] == ["hidden_storage"]
    flow, time = found["effects"][0]["parameters"].values()
    assert (flow["unit"], time["unit"]) == ("W/degC", "s")
    assert flow["ci95"][0] < 40.0 < flow["ci95"][1]
    assert time["ci95"][0] < 5e4 < time["ci95"][1]
    model = Model(rig, rig.to_explain(), {"hidden_storage": known["hidden_storage"]})
    assert model.states(model.values)[0][0].tolist() == [18.0, 18.0]


def test_faults_of_a_recording_are_marked(rigs):
    effects = table.general(rigs["two"], recording(rigs["two"]), every=True)
    assert {e.id.removesuffix("_x").removesuffix("_y") for e in effects.values() if e.fault} == {
        "sensor_offset", "sensor_gain", "sensor_drift", "sensor_saturation", "sensor_lower_end", "late_channel",
        "channel_clock", "lost_samples", "line_pickup",
    }  # fmt: skip


def _late(x, t):
    return np.r_[x[:1], x[:1], x[:-2]]


FAULTS = {
    "late_channel": (_late, "omega_late", 0.01),
    "line_pickup": (lambda x, t: x + 2.0 * np.sin(2 * np.pi * 49.93 * t + 1.0), "omega_line", 2.0),
    "lost_samples": (lambda x, t: np.r_[x[:400], x[412:], np.full(12, x[-1])], "omega_lost", 0.06),
    "sensor_saturation": (lambda x, t: np.minimum(x, 60.0), "omega_top", 60.0),
    "sensor_lower_end": (lambda x, t: np.maximum(x, -60.0), "omega_bottom", -60.0),
    "sensor_drift": (lambda x, t: x + 0.8 * t, "omega_drift", 0.8),
    "sensor_play": (lambda x, t: filters.loose(x, 3.0, DT), "omega_play", 3.0),
    "channel_clock": (lambda x, t: np.interp(t * 1.004, t, x), "omega_clock", 0.004),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_fault_of_the_recording_is_named_with_its_size(fault, tmp_path):
    change, name, size = FAULTS[fault]
    t = np.arange(1200) * DT
    rig = made(tmp_path / "motor", "motor", after=lambda c: c | {"omega": change(c["omega"], t)}, noise=0.5)
    found = diagnose(rig, effects=table.general(rig, recording(rig))).as_dict()
    assert fault in [e["id"] for e in found["effects"]], found["effects"]
    value = next(e for e in found["effects"] if e["id"] == fault)["parameters"][name]["value"]
    assert value == pytest.approx(size, rel=0.1)


# -- filters and units by hand ---------------------------------------------------------------------------------------

SIGNAL = np.array([0.0, 1.0, 3.0, 2.0, -1.0])
BY_HAND = {
    "saturation": ((1.0, 2.0), [0.0, 1.0, 2.0, 2.0, -1.0]),
    "rate_limit": ((1.0, 10.0), [0.0, 1.0, 2.0, 2.0, 1.0]),
    "quantum": ((1.0, 2.0), [0.0, 0.0, 4.0, 2.0, 0.0]),
    "fading": ((1.0,), [0.0, 1.1, 3.6, 2.6, -1.4]),
}
READ = {
    "late": ((0.05,), [-0.5, 0.125, 2.125, 2.8125, 0.6875]),  # (-1, 9, 9, -1) / 16 of the four around, but at the ends
    "clock": ((0.5,), [0.0, 2.125, 2.0, -1.0, -1.0]),
    "lost": ((0.1, 0.1), [0.0, 1.0, 2.0, -1.0, -1.0]),
    "play": ((1.0,), [0.0, 0.0, 2.0, 2.0, 0.0]),
    "behind": ((1e-9,), SIGNAL.tolist()),
}


@pytest.mark.parametrize(("kind", "given", "expected"), [(k, *v) for k, v in (BY_HAND | READ).items()])
def test_filters_by_hand(kind, given, expected):
    function = (filters.INPUT | filters.SENSOR)[kind]
    assert function(SIGNAL, *given, 0.1) == pytest.approx(expected)
    none = function(SIGNAL, 0.0, *given[1:], 0.1)
    assert none == pytest.approx(SIGNAL)


def test_a_resonance_rings_at_its_period_and_passes_what_is_constant():
    ringing = filters.resonant(np.r_[np.zeros(10), np.ones(400)], 1.0, 0.2, 0.05, 0.01)
    assert ringing[-1] == pytest.approx(1.0, abs=5e-3)
    peaks = [k for k in range(11, 400) if ringing[k - 1] < ringing[k] > ringing[k + 1]]
    assert np.diff(peaks[:4]) == pytest.approx(20.0, abs=1.0)


@pytest.mark.parametrize(
    ("expression", "unit"),
    [("m * v * abs(v)", "N"), ("sqrt(p)", "Pa^(1/2)"), ("x * sin(x) + x", "m"), ("orifice(x, p, p)", "m Pa^(1/2)")],
)
def test_units_of_expressions(expression, unit):
    known = {"m": "N s^2/m^2", "v": "m/s", "p": "Pa", "x": "m"}
    assert units.of(expression, known) == units.powers(unit)


def test_what_has_no_unit_has_none():
    assert units.of("x + p", {"x": "m", "p": "Pa"}) is None
    assert units.powers("m per s!") is None
    assert places.is_rate("rad/s")
    assert not places.is_rate("rad/s^2")
