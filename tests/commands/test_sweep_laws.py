"""Laws in Python in `python -m sim.sweep`: what they make of a sinusoid, and how much of it is elsewhere."""

import json
from dataclasses import replace

import numpy as np
import pytest

from models.common.errors import InputError
from models.document.text import text_lines
from models.laws.python_law import PythonController
from models.roads.spectrum import as_met
from models.vehicle.limits_and_implementation import Implementation
from models.vehicle.vehicle import read_vehicle
from sim.command.comparison import controllers_of
from sim.inspect.log import read_log
from sim.inspect.proof import prove
from sim.linear.frequency_response import sampled_frequency_response
from sim.studies.frequency.describing_function import describing_function
from sim.studies.frequency.report import describe
from sim.studies.frequency.sweep import holds
from sim.sweep import main
from synth.vehicle.designer import Designer
from tests.models.test_python_laws import vehicle_of

FEW = 10  # of the 20 sinusoids that the command drives
LOW, LOWEST = 0.2, 0.1  # Hz: a run is three periods; at the lower, of the command, free motion is gone after two
FINE = 4e-3  # s
STEP, AMPLITUDE, SPEED = 2e-3, 1e-4, 12.5  # s, m, m/s; half the work of the command's own step
COARSE = 8e-3  # s, where no number is held against an exact one
# For all of a frequency's runs at once: 300 000 calls are seconds.
SQUARE = """
import numpy as np
def step(sample, state):
    return np.full((len(sample.y), 1), 0.1 if sample.time % 2.0 < 1.0 else -0.1), state
step.vectorised = True
"""
RELAY = """
import numpy as np
def step(sample, state):
    force = 0.05 * (1 + (sample.time + 1e-9) // 5.0)
    return np.where(sample.preview[:, 0, 1] > sample.preview[:, 0, 0], force, -force)[:, None], state
step.vectorised = True
"""
GAIN = """
def step(sample, state):
    return (10825.2 * sample["suspension_deflection"] - 2069.5 * sample["sprung_velocity"])[:, None], state
step.vectorised = True
"""


@pytest.fixture(scope="module", autouse=True)
def few_sinusoids():
    """Takes few sinusoids: each is like the others, and costs three periods of the slowest."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("sim.studies.frequency.describing_function.SINUSOIDS", FEW)
        yield


def found_of(folder, law: str, how: Implementation | None = None, more: str = "", step: float = STEP, lowest: float = LOW):
    """Returns what a law makes of sinusoids from `lowest` [Hz] on, and its vehicle."""
    vehicle = read_vehicle(vehicle_of(folder, law, more=more))
    vehicle = replace(vehicle, implementation=how or Implementation())
    (mine,) = controllers_of(vehicle, ["mine"], Designer(vehicle).design)
    assert isinstance(mine, PythonController)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr("sim.studies.frequency.sinusoids.LOWEST", lowest)
        return describing_function(vehicle, mine, AMPLITUDE, step, SPEED), vehicle


@pytest.fixture(scope="module")
def gain(tmp_path_factory):
    """Returns what a gain in Python makes of them."""
    return found_of(tmp_path_factory.mktemp("gain"), GAIN, lowest=LOWEST)


@pytest.mark.attack
@pytest.mark.parametrize("how", [None, Implementation(sample_period=4e-3, delay=1)], ids=["prompt", "slow"])
def test_of_a_gain_it_is_its_frequency_response(tmp_path, gain, how):
    """For a gain in Python it is the sampled loop's exact response, and nothing but the images of a slow hold is outside."""
    found, vehicle = gain if how is None else found_of(tmp_path, GAIN, how, lowest=LOWEST)
    linear = Designer(vehicle).design("I_printed")
    linear = replace(linear, law=replace(linear.law, D=np.array([[10825.2, -2069.5]])))
    met = as_met(vehicle, found.omega, SPEED)[..., None]
    exact = (sampled_frequency_response(vehicle, linear, found.omega, STEP) @ met)[..., 0]
    # RK4's own error at 2 ms is 4e-5 (test_sweep); of free motion of -1.2 1/s nothing is left after 20 s.
    np.testing.assert_allclose(found.measured, exact, rtol=1e-4)
    assert found.drift < 1e-4
    if how is None:
        assert np.nanmax(found.outside) < 1e-8
    else:
        low = found.omega < 2 * np.pi  # a hold of 4 ms: its images have (omega h)^2 / 12 of the force's energy, some 5e-5
        assert 1e-9 < np.nanmax(found.outside[low, -1]) < 1e-4


def test_what_is_outside_is_measured(tmp_path):
    """A force that is switched as the road rises and falls has a fundamental of 4 / pi; 1 - 8 / pi^2 of its energy is outside.

    It is 50 mN more in each period of the lowest: measured is the third, which differs by a third of its own from the second.
    """
    found, _ = found_of(tmp_path, RELAY, more=f"preview = {FINE}", step=FINE)
    force = found.outputs.index("control_force")
    slow = found.omega < 2 * np.pi  # in whole samples: a step of 4 ms is at most 0.4 % of a period
    assert np.sum(slow) > 2
    np.testing.assert_allclose(found.outside[slow, force], 1 - 8 / np.pi**2, atol=1e-5)
    driven_by = AMPLITUDE / 2 * found.omega[slow]  # the road's velocity
    np.testing.assert_allclose(np.abs(found.measured[slow, force]) * driven_by, 0.15 * 4 / np.pi, rtol=1e-4)
    assert found.drift == pytest.approx(1 / 3, rel=1e-3)
    acceleration = found.outputs.index("sprung_acceleration")
    assert 0 < found.outside[slow, acceleration].min() < found.outside[slow, acceleration].max() < 1


@pytest.mark.attack
def test_a_law_that_does_not_follow_the_road(tmp_path):
    """A force that goes its own way is energy outside, and no norm is claimed; the log proves as much."""
    path = vehicle_of(tmp_path, SQUARE)
    options = ["--vehicle", str(path), "--controller", "I", "--controller", "mine", "--timestep", f"{COARSE}"]
    assert main([*options, "--logs", str(tmp_path / "logs")]) == 0
    (log,) = (tmp_path / "logs").glob("*.mcap")
    recorded = read_log(log)
    linear, mine = json.loads(recorded.attachments["result.json"])["sweeps"]
    assert linear["norm"]["sampled"] > 0
    assert (mine["controller"], mine["law"], mine["norm"], mine["failures"]) == ("mine", "mine.py:step", None, [])
    assert max(mine["signals"]["control_force"]["outside"]) > 0.99
    assert prove(recorded).holds


def test_a_law_that_fails_ends_the_sweep(tmp_path):
    """A law that fails is one line."""
    path = vehicle_of(tmp_path, "def step(sample, state):\n    return float('nan'), state\n")
    with pytest.raises(
        InputError,
        match=r"^controller 'mine', law mine.py:step: .*the returned force is not finite; return finite numbers\) at 0 s",
    ):
        main(["--vehicle", str(path), "--controller", "mine"])


WILD = """
import numpy as np
def step(sample, state):
    rise = np.abs(sample.preview[:, 0, 1] - sample.preview[:, 0, 0])
    return np.where(rise > {limit}, 1e300, 0.0)[:, None], state
step.vectorised = True
"""


def test_runs_that_diverge_are_said_once(tmp_path, recwarn):
    """Runs that diverge are not measured, which one line says; the others have their numbers. If all diverge, the sweep fails."""
    found, vehicle = found_of(tmp_path, WILD.format(limit=8e-6), more=f"preview = {COARSE}", step=COARSE)
    wild, count = np.isfinite(found.diverged), len(found.omega)
    # A road of 0.1 mm rises by 0.05 mm * omega * 8 ms in a step, at most: more than 8e-6 m from 20 rad/s on.
    assert np.array_equal(wild, found.omega > 20.0)
    assert 0 < wild.sum() < count
    for numbers in (found.gains, found.measured, found.outside):
        assert np.isnan(numbers[wild]).all()
    assert np.isfinite(found.gains[~wild]).all()
    first = f"the first at {found.diverged.min():.4g} s"
    some = f"{wild.sum()} of {count} runs diverged, {first}. The results do not contain these runs."
    nothing = replace(found, diverged=np.zeros(count), ended=("divergence",))
    for one, said, state in ((found, some, "note"), (nothing, "every run diverged, so nothing is measured.", "fails")):
        document = describe(vehicle, [], [], [one], AMPLITUDE, COARSE)
        assert [each.text for each in document.statements if "diverged" in each.text] == [f"`mine`: {said}"]
        assert document.state == state
        assert holds(one) is (state == "note")  # the command's exit code is 0
    assert "nan" not in " ".join(text_lines(describe(vehicle, [], [], [found], AMPLITUDE, COARSE), "full"))
    assert not recwarn.list


@pytest.mark.attack
def test_a_law_of_which_nothing_is_measured_is_no_success(tmp_path, capsys):
    """If every run diverged the command exits with 1, and `--json` gives the reason."""
    path = vehicle_of(tmp_path, WILD.format(limit=-1.0), more=f"preview = {COARSE}")
    assert main(["--vehicle", str(path), "--controller", "mine", "--timestep", f"{COARSE}", "--json"]) == 1
    (found,) = json.loads(capsys.readouterr().out)["sweeps"]
    assert found["failures"] == ["every run diverged, so nothing is measured"]
