"""What several tests share: the paper's vehicle, its designs, and vehicles drawn at random."""

import dataclasses

import numpy as np
import pytest
from mcap.reader import make_reader

from models.vehicle import Vehicle, read_vehicle
from synth.controller import Designer


@pytest.fixture(scope="session")
def paper() -> Vehicle:
    """The paper's quarter-car."""
    return read_vehicle("quarter_car")


@pytest.fixture(scope="session")
def designer(paper) -> Designer:
    """The designs of the paper's quarter-car."""
    return Designer(paper)


def random_vehicles(vehicle: Vehicle, count: int, spread: float = 0.5) -> list[Vehicle]:
    """Vehicles of the same kind with every parameter within +- `spread` of this one's."""
    rng = np.random.default_rng(20261120)
    return [
        dataclasses.replace(
            vehicle,
            parameters={name: value * rng.uniform(1 - spread, 1 + spread) for name, value in vehicle.parameters.items()},
        )
        for _ in range(count)
    ]


def recorded_runs(mcap: str) -> set[str]:
    """Names of the runs in a log."""
    with open(mcap, "rb") as stream:
        return {item.name.removeprefix("run/") for item in make_reader(stream).iter_metadata()} - {"roadproof"}
