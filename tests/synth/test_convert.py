"""Responses and designs leave as pandas' and python-control's own objects, with their names."""

import control
import numpy as np
import pytest

from models.roads.road import Bump
from models.vehicle.vehicle import read_vehicle
from sim.drive.response import Response
from synth.vehicle.designer import design
from synth.vehicle.state_space import closed_loop
from tests.support.analysed import continuous_response
from tests.support.weighted import weighted_loop

TIME = np.arange(2001) * 1e-3


@pytest.fixture(scope="module")
def response(paper, designer):
    return continuous_response(paper, designer.design("I"), Bump(), TIME)


def test_to_pandas(response):
    """Columns are the signals, the index is time, units go along."""
    pytest.importorskip("pandas")
    frame = response.to_pandas()
    assert list(frame.columns) == list(response.names)
    assert frame.index.name == "time"
    assert frame.attrs["units"]["sprung_acceleration"] == "m/s2"
    np.testing.assert_array_equal(frame["tyre_deflection"].to_numpy(), response["tyre_deflection"])


def test_to_control(paper, response):
    """Outputs and road are found by name."""
    found = response.to_control(paper)
    np.testing.assert_array_equal(found.time, TIME)
    labels = found.output_labels or []
    assert labels == list(paper.linear_model.outputs)
    assert found.input_labels == ["road_velocity"]
    np.testing.assert_array_equal(np.squeeze(found.outputs[labels.index("control_force")]), response["control_force"])


@pytest.mark.parametrize("name", ["quarter_car", "half_car", "full_car"])
def test_weighted_loop_has_the_norm_of_the_certificate(name):
    """To z, weighted and called so, python-control computes the same H-infinity norm from the system as the certificate says.

    It is the signals times their weights, from every road velocity and twist alike.
    """
    vehicle = read_vehicle(name)
    controller = design(vehicle, "I")
    plain, system = closed_loop(vehicle, controller), weighted_loop(vehicle, controller)
    omega = np.append(np.geomspace(1, 100, 100), controller.certificate.norm.peak_frequency)
    largest = max(np.linalg.norm(system(1j * w), 2) for w in omega)
    assert largest == pytest.approx(controller.certificate.norm.value, rel=1e-9)  # its own peak is among the frequencies
    weights = {signal: weight for signal, weight in vehicle.performance.items() if weight > 0}
    assert (system.input_labels, system.output_labels) == (plain.input_labels, [f"z[{signal}]" for signal in weights])
    rows = [plain.output_labels.index(signal) for signal in weights]
    for w in (1j, 64j):
        np.testing.assert_allclose(system(w), np.array([*weights.values()])[:, None] * plain(w)[rows], rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("name", ["quarter_car", "half_car"])
def test_closed_loop_answers_in_units(name):
    """A system's output is the signal of its name, in its unit: over a bump every output moves as our response does."""
    vehicle, road = read_vehicle(name), Bump()
    controller = design(vehicle, "I")
    system, own = closed_loop(vehicle, controller), continuous_response(vehicle, controller, road, TIME)
    assert system.output_labels == list(vehicle.linear_model.outputs)
    found = control.forced_response(system, TIME, np.stack([own[label] for label in system.input_labels]))  # type: ignore[arg-type]
    for i, signal in enumerate(system.output_labels):
        # forced_response takes the road as linear between samples: (h omega)^2 / 12 of what it has at 64 rad/s, the wheel's.
        np.testing.assert_allclose(found.outputs[i], own[signal], atol=3.5e-4 * np.abs(own[signal]).max())


def test_what_does_not_fit_is_named(paper, response):
    """Several runs are no table."""
    many = Response(response.time, response.signals, np.stack([response.values] * 2))
    for convert in (Response.to_pandas, lambda one: one.to_control(paper)):
        with pytest.raises(ValueError, match="select one"):
            convert(many)
