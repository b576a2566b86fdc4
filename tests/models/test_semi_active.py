"""The built-in semi-active laws: the coefficients that they request, and their runs."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from models.common.errors import InputError
from models.laws.semi_active import LAWS, SemiActive, SemiActiveLaw
from models.roads.choice import choose_road
from models.vehicle.semi_active_coefficients import numbers_of
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from sim.runs.report import controller_notes, controller_record, verdict
from sim.runs.run import run_controllers, sample_times
from tests.models.test_semi_active_dampers import BUMP, DAMPER, HALF, QUARTER, check_physics
from tests.support.analysed import simulate
from tests.support.commands import attacks

NAMES = [name for name in LAWS if name != "skyhook_modal"]
SOFT, HARD, SPRING = 300.0, 4000.0, 13100.0
EACH = "".join(f'[controllers.{name}]\nsemi_active = "{name}"\n' for name in NAMES)
CAR = HALF[: HALF.index("[actuators.front]")] + DAMPER


def law_of(text: str, name: str) -> tuple[SemiActiveLaw, SemiActive]:
    """A law of a vehicle file."""
    law = parse_vehicle(text).controllers[name].source
    assert isinstance(law, SemiActiveLaw)
    return law, SemiActive(name, law)


def asked(name: str, z: float, z_s: float, z_u: float, a: float) -> float:
    """What a law asks for, case by case as its source has it: travel, velocity of body and wheel, acceleration of the body."""
    v = z_s - z_u
    if name == "skyhook":
        return HARD if z_s * v > 0 else SOFT
    if name == "skyhook_linear":
        return HARD * z_s / v if z_s * v > 0 else SOFT
    if name == "groundhook":
        return HARD if -z_u * v > 0 else SOFT
    if name == "hybrid":
        return (0.5 * (HARD * z_s / v if z_s * v > 0 else 0.0)) + 0.5 * (-HARD * z_u / v if -z_u * v > 0 else 0.0)
    if name == "add":
        return HARD if a * v > 0 else SOFT
    if name == "pdd":
        if SPRING * z * v + SOFT * v * v >= 0:
            return SOFT
        return HARD if SPRING * z * v + HARD * v * v < 0 else -SPRING * z / v
    slow = a * a - 12.0**2 * z_s * z_s <= 0
    return HARD if (slow and z_s * v > 0) or (not slow and a * v > 0) else SOFT


@pytest.mark.parametrize("name", NAMES)
def test_what_a_law_asks_for(name):
    """Each law is its source's, in all signs of what it measures, also of many vehicles at once."""
    law, _ = law_of(QUARTER + DAMPER + EACH, name)
    numbers = numbers_of([law], [parse_vehicle(QUARTER + DAMPER)])
    rng = np.random.default_rng(0)
    states = rng.normal(size=(200, 4)) * [0.02, 0.5, 0.7, 3.0]
    signals = ["suspension_deflection", "sprung_velocity", "unsprung_velocity", "sprung_acceleration"]
    columns = {signal: states[:, i] for i, signal in enumerate(signals)}
    y = np.stack([columns[signal] for signal in law.measured], axis=-1)
    found = law.coefficients(y, numbers)[:, 0]
    expected = np.array([asked(name, *state) for state in states])
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    assert len(set(np.sign(expected - (SOFT + HARD) / 2))) == 2  # hard and soft both


def test_keys_change_a_law():
    """The numbers that a section gives are those that its law has: half the damper to the sky is half the force."""
    text = QUARTER + DAMPER + '[controllers.soft]\nsemi_active = "skyhook_linear"\nsky_damping = 2000.0\n'
    law, controller = law_of(text, "soft")
    (found,) = law.coefficients(np.array([[0.2, 0.1]]), numbers_of([law], [parse_vehicle(text)]))
    assert found == pytest.approx([4000.0])  # 2000 N s/m * 0.2 m/s over 0.1 m/s
    assert "sky_damping 2000" in controller_notes(parse_vehicle(text), controller)[0]
    assert controller_record(controller)["sky_damping"] == 2000.0
    assert controller_record(controller)["norm"] is None


def test_modes_are_corners():
    """If heave and pitch are damped alike, modal skyhook is that of the corners; one not damped asks for nothing."""
    by_corners = SemiActiveLaw("skyhook_linear", (), ("_front", "_rear"))
    modes = ("heave_velocity", "pitch_rate")
    modal = SemiActiveLaw("skyhook_modal", (), ("_front", "_rear"), modes)
    only = SemiActiveLaw("skyhook_modal", (("pitch_damping", 0.0),), ("_front", "_rear"), modes)
    heave, pitch, wheels = 0.3, 0.1, np.array([0.05, -0.2])
    body = np.array([heave - 1.3 * pitch, heave + 1.5 * pitch])  # nose down
    corners = by_corners.coefficients(np.array([[*body, *wheels]]), numbers_of([by_corners], [parse_vehicle(CAR)]))
    found = modal.coefficients(np.array([[heave, pitch, *wheels]]), numbers_of([modal], [parse_vehicle(CAR)]))
    np.testing.assert_allclose(found, corners, rtol=1e-12)
    found = only.coefficients(np.array([[heave, pitch, *wheels]]), numbers_of([only], [parse_vehicle(CAR)]))
    np.testing.assert_allclose(found[0], HARD * heave / (body - wheels), rtol=1e-12)


@pytest.mark.parametrize(
    ("kind", "road"),
    [("quarter_car", "bump"), *attacks(itertools.product(("half_car", "full_car"), ("bump", "iso8608:class=C")))],
)
def test_runs_agree(kind, road):
    """The run of every law agrees to rounding, and its dampers dissipate energy at every sample."""
    names = [name for name in LAWS if name != "skyhook_modal" or kind != "quarter_car"]
    sections = "".join(f'[controllers.law_{name}]\nsemi_active = "{name}"\n' for name in names)
    vehicle = parse_vehicle(read_vehicle(kind).text + DAMPER + sections)
    over = BUMP if road == "bump" else choose_road(road).build(vehicle, 15.0, 0, 10.0)
    drivers = [vehicle.controllers[f"law_{name}"].driver() for name in names]
    for run in run_controllers(vehicle, drivers, over, sample_times(vehicle, 0.5, 1e-3)):
        check_physics(run)
        assert verdict(run).text.startswith("MuJoCo agrees with the model; no linear analysis")


@pytest.mark.attack
def test_a_law_is_decided_before_a_step_as_by_a_computer():
    """Set in the loop itself, of a run alone and of many, dampers are what a computer of every timestep makes of them."""
    text = QUARTER + DAMPER + EACH
    slow = parse_vehicle(text + "[implementation]\nsample_period = 0.002\n")
    fast = parse_vehicle(text)
    for name in NAMES:
        law = law_of(text, name)[1]
        time = sample_times(fast, 0.3, 1e-3)
        alone = simulate([fast], [law], [BUMP], time).response.run(0)
        three = simulate([fast] * 3, [law] * 3, [BUMP] * 3, time).response.run(1)
        # Delays of 0 beside one of 5 ms: `Sampler` holds all of them, this one at every timestep.
        late = replace(fast, implementation=replace(fast.implementation, delay=5.0))
        other = simulate([fast, late], [law] * 2, [BUMP] * 2, time).response.run(0)
        for signal in ("damping", "missing_force", "sprung_velocity"):
            for one in (three, other):
                assert np.abs(alone[signal] - one[signal]).max() <= 1e-9 * np.abs(alone[signal]).max()
        held = simulate([slow], [law], [BUMP], time).response.run(0)["damping"]
        assert np.array_equal(held[:-1:2], held[1::2])


def test_laws_side_by_side():
    """Laws of different kinds run side by side as each does among its own, to the last bit."""
    vehicle = parse_vehicle(QUARTER + DAMPER + EACH)
    laws = [law_of(QUARTER + DAMPER + EACH, name)[1] for name in ("skyhook", "pdd", "skyhook_add")]
    time = sample_times(vehicle, 0.4, 1e-3)
    together = simulate([vehicle] * 3, laws, [BUMP] * 3, time)
    for i, law in enumerate(laws):
        pair = simulate([vehicle] * 2, [law] * 2, [BUMP] * 2, time)
        difference = np.abs(together.response.values[i] - pair.response.values[0]).max(axis=0)
        assert np.all(difference <= 1e-9 * np.abs(pair.response.values[0]).max(axis=0))


def test_a_law_needs_dampers():
    """A law that sets dampers has no linear claim."""
    vehicle = parse_vehicle(QUARTER + DAMPER + EACH)
    assert set(NAMES).isdisjoint(vehicle.linear_names)
    with pytest.raises(InputError, match="is a semi-active law, which has no linear loop"):
        vehicle.linear_entry("add")
