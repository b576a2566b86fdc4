"""Bump stops that are progressive, or unlike in bump and rebound: their force, their events, their energy."""

# pyright: reportAttributeAccessIssue=false
# MuJoCo's bindings carry no type stubs.

import json

import numpy as np
import pytest
from scipy import stats

from models.roads.iso8608 import Iso8608
from models.roads.road import Bump
from models.vehicle.limits_and_implementation import read_limits
from models.vehicle.mjcf import build_model, mjcf_text
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.drive.regime import end_times
from sim.runs.record import RUN
from sim.runs.report import reasons, verdict
from sim.runs.run import run_controllers, sample_times
from sim.runs.stops import stop_note
from sim.studies.ride.expected import expect
from sim.studies.ride.metrics import measure, metrics_of
from synth.vehicle.designer import Designer
from tests.support.analysed import energy, simulate

BUMP = Bump()
UNLIKE = "\n[limits]\nsuspension_stroke = { bump = 0.05, rebound = 0.07 }\nstop_stiffness = "
STOPS = {"linear": "1e5", "progressive": "[4e4, 2e6, 3e8]", "of each side": "{ bump = [4e4, 2e6, 3e8], rebound = 2e5 }"}


PLACES = """
[limits.rear]
suspension_stroke = { bump = 0.06, rebound = 0.09 }

[limits.rear_left]
stop_stiffness = [3e4, 0.0, 1e8]
"""


def built(text, kind="quarter_car"):
    """A vehicle that ships, with limits."""
    return parse_vehicle(read_vehicle(kind).text + text)


CAR = """type = "quarter_car"
[parameters]
sprung_mass = 420.0
unsprung_mass = 45.0
suspension_stiffness = 22e3
suspension_damping = 1500.0
tyre_stiffness = 210e3
[performance]
sprung_acceleration = 1.0
[limits]
suspension_stroke = %s
stop_stiffness = 1e5
"""


def driven(kind, road=BUMP, duration=0.6):
    """Returns the run of the passive vehicle, after what `sim.bump` prints of it and its object in JSON."""
    (run,) = run_controllers(kind, [Designer(kind).design("passive")], road, sample_times(kind, duration, 1e-3))
    return run, RUN(run), stop_note(run)


def test_each_stop_is_named_with_squeeze_force_and_time():
    """Both stops of a car are named with what MuJoCo does there: its body's equation leaves over the same force."""
    run, made, lines = driven(parse_vehicle(CAR % "0.06"))
    assert lines == "stops: bump 1.18 mm, 118 N at 0.169 s; rebound 17.7 mm, 1773 N at 0.381 s"
    assert lines == reasons(run)[0].text
    assert "linear analysis applies until 0.157 s (bump stop)" in verdict(run).text
    of = {signal.name: run.physics[signal.name] for signal in run.physics.signals}
    up = 420 * of["sprung_acceleration"] + 22e3 * of["suspension_deflection"]
    up += 1500 * (of["sprung_velocity"] - of["unsprung_velocity"])
    for side, force in {"bump": up.max(), "rebound": -up.min()}.items():
        one = made["stops"]["suspension_deflection"][side]
        assert one["force"] == pytest.approx(force, rel=1e-9)  # rounding
        assert one["squeeze"] == pytest.approx(force / 1e5, rel=1e-9)
        assert run.physics.time[np.abs(up).argmax() if side == "rebound" else up.argmax()] == one["time"]


def test_a_side_that_is_left_out_has_no_stop():
    """With `{ bump = 0.06 }`, or rebound alone, the other side never pushes, ends nothing, and is in no sentence."""
    far = parse_vehicle(CAR % "{ bump = 0.06, rebound = 10.0 }")
    one = parse_vehicle(CAR % "{ bump = 0.06 }")
    apart, (run, made, lines) = driven(far)[0], driven(one)
    np.testing.assert_array_equal(run.physics.values, apart.physics.values)  # a spring that is never reached adds nothing
    assert run.passed
    assert lines == "stops: bump 1.18 mm, 118 N at 0.169 s"
    assert set(made["stops"]["suspension_deflection"]) == {"bump"}
    assert one.limits.phrases(one.kind.suspensions) == ("bump stops at -0.06 m in bump",)
    written = json.loads(json.dumps(one.limits.record))
    assert read_limits({key: value for key, value in written.items() if value is not None}, one.kind.suspensions) == one.limits
    assert one.limits.written == {"suspension_stroke.bump": "0.06", "stop_stiffness": "100000"}
    run, made, lines = driven(parse_vehicle(CAR % "{ rebound = 0.06 }"))
    assert lines.startswith("stops: rebound ")
    assert "(rebound stop)" in verdict(run).text
    assert reasons(run)[1].text.startswith("rebound stop: a suspension first reaches the end of its stroke at ")
    assert "bump" not in made["stops"]["suspension_deflection"]


def test_alike_stops_are_one_spring_as_before():
    """Stops given for each side that are the same are the model that one number gives, bit for bit."""
    plain = "\n[limits]\nsuspension_stroke = 0.05\nstop_stiffness = 1e5"
    sides = "\n[limits]\nsuspension_stroke = { bump = 0.05, rebound = 0.05 }\nstop_stiffness = { bump = [1e5], rebound = 1e5 }"
    one, other = (built(text, "full_car") for text in (plain, sides))
    assert mjcf_text(one, 1e-3) == mjcf_text(other, 1e-3)


def test_limits_are_read_back_from_logs():
    """The limits of a log are read back as the same limits, with lists and sides."""
    for kind in ("quarter_car", "full_car"):
        for stiffness in STOPS.values():
            vehicle = built(UNLIKE + stiffness + (PLACES if kind == "full_car" else ""), kind)
            written = json.loads(json.dumps(vehicle.limits.record))
            said = {name: value for name, value in written.items() if value is not None}
            assert read_limits(said, vehicle.kind.suspensions) == vehicle.limits
            hash(vehicle.limits)


def test_stops_of_an_axle_are_its_own():
    """Every suspension's stops in MuJoCo, in the events, metrics and words are those of the section nearest to it."""
    vehicle = built(UNLIKE + "1e5" + PLACES, "full_car")
    assert vehicle.limits.phrases(vehicle.kind.suspensions) == (
        "bump stops at -0.05 m in bump and +0.07 m in rebound (front)",
        "progressive bump stops at -0.06 m in bump and +0.09 m in rebound (rear_left)",
        "bump stops at -0.06 m in bump and +0.09 m in rebound (rear_right)",
    )
    found = vehicle.limits.stops(vehicle.kind.suspensions)
    model = build_model(vehicle, 1e-3)
    wanted = {}
    for one in vehicle.kind.suspensions:
        rear, left = one.corner.startswith("rear"), one.corner == "rear_left"
        wanted[one.deflection] = (0.06, 0.09) if rear else (0.05, 0.07)
        bump, rebound = found[one.deflection]
        assert (bump.stroke, rebound.stroke) == wanted[one.deflection]
        assert bump.stiffness == rebound.stiffness == ((3e4, 0.0, 1e8) if left else (1e5, 0.0, 0.0))
        spring, rest = model.tendon(f"stop_{one.tendon}").id, model.tendon_length0[model.tendon(one.tendon).id]
        slack = model.tendon_lengthspring[spring] - rest
        assert slack == pytest.approx([-wanted[one.deflection][0], wanted[one.deflection][1]], abs=1e-12)
        assert model.tendon_stiffness[spring] == (3e4 if left else 1e5)
    road, time = Bump(height=0.15, length=2.0, speed=8.0), sample_times(vehicle, 1.5, 1e-3)
    runs = simulate([vehicle], [Designer(vehicle).design("passive")], [road], time)
    response = runs.response.run(0)
    beyond = {name: (response[name] <= -low) | (response[name] >= high) for name, (low, high) in wanted.items()}
    assert all(one.any() for one in beyond.values())
    assert end_times(vehicle, response)[1] == time[min(int(one.argmax()) for one in beyond.values())]
    measured = measure(vehicle, response, 0)
    assert {name: measured[f"{name}_at_stops"] for name in wanted} == {name: one.mean() for name, one in beyond.items()}
    assert energy(vehicle, runs, 0, road).residual < 1e-4  # kinks where a stop begins to act


def test_an_axle_may_be_without_stops():
    """Stops of one axle alone: of the other there is neither a spring nor a metric, and what is expected knows it."""
    vehicle = built("\n[limits.front]\nsuspension_stroke = { bump = 0.02, rebound = 0.03 }\nstop_stiffness = 1e5", "half_car")
    model = build_model(vehicle, 1e-3)
    names = [model.tendon(i).name for i in range(model.ntendon)]
    assert [name for name in names if name.startswith("stop")] == ["stop_suspension_front"]
    metrics = [one.name for one in metrics_of(vehicle) if one.what == "at_stops"]
    assert metrics == ["suspension_deflection_front_at_stops"]
    expected = expect(vehicle, Designer(vehicle).design("passive"), Iso8608("C", 0, 20.0).spectrum, 1e-3, 10.0)
    assert expected is not None
    sigma = expected.mean["suspension_deflection_front_rms"]
    tails = sum(float(stats.norm.sf(stroke / sigma)) for stroke in (0.02, 0.03))
    assert expected.mean["suspension_deflection_front_at_stops"] == pytest.approx(tails, rel=1e-9)
    assert "suspension_deflection_rear_at_stops" not in expected.mean
