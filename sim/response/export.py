"""Ways out: responses and designs as the objects that notebooks start from."""

from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from models.vehicle import Vehicle
from sim.response.response import Response
from synth.controller import Controller, generalized_plant

if TYPE_CHECKING:
    import control
    import pandas as pd


def to_pandas(response: Response) -> "pd.DataFrame":
    """One run as a DataFrame: a column per signal, the time [s] as index, units in `attrs["units"]`.

    Raises:
        ValueError: the response holds several runs; take one with `run`.
    """
    import pandas as pd

    _single(response)
    frame = pd.DataFrame(response.values, index=pd.Index(response.time, name="time"), columns=list(response.names))
    frame.attrs["units"] = {signal.name: signal.unit for signal in response.signals}
    return frame


def to_control(vehicle: Vehicle, response: Response) -> "control.TimeResponseData":
    """One run as python-control's responses are: the vehicle's outputs over its road, by name.

    Raises:
        ValueError: the response holds several runs; take one with `run`.
    """
    import control

    _single(response)
    outputs = vehicle.linear_model.outputs
    roads = tuple(wheel.road_velocity for wheel in vehicle.kind.wheels)
    return control.TimeResponseData(
        response.time,
        np.stack([response[name] for name in outputs]),
        inputs=np.stack([response[name] for name in roads]),
        output_labels=list(outputs),
        input_labels=list(roads),
        issiso=False,
    )


def vehicle_system(vehicle: Vehicle) -> "control.StateSpace":
    """The vehicle (29), continuous: from road velocities and control forces to all its outputs, all by name.

    Where the road's height acts as such (a full car's twist) there is no such system without another state; see `closed_loop`.

    Raises:
        ValueError: the road's height acts as such.
    """
    from control import StateSpace, ss

    model = vehicle.linear_model
    if np.any(model.Br) or np.any(model.Cr):
        raise ValueError(f"in a {vehicle.kind.name} the road's height acts beside its velocity; use closed_loop")
    roads = [wheel.road_velocity for wheel in vehicle.kind.wheels]
    system = ss(
        model.A,
        np.hstack([model.Bw, model.B]),
        model.C,
        np.hstack([np.zeros((len(model.C), len(roads))), model.D]),
        name=vehicle.kind.name,
        states=list(model.states),
        inputs=[*roads, *model.inputs],
        outputs=list(model.outputs),
    )
    assert isinstance(system, StateSpace)
    return system


def closed_loop(vehicle: Vehicle, controller: Controller) -> "control.StateSpace":
    """The closed loop (16), continuous, from the roads to every output of the vehicle, each by its name and in its unit.

    The first inputs are the road velocities [m/s]. Where the road's height acts as such, as in a full car, its twists follow,
    each as a velocity: its height times the model's `twist_rate`.
    """
    outputs = vehicle.linear_model.outputs
    return _loop(replace(vehicle, performance=dict.fromkeys(outputs, 1.0)), controller, outputs)


def weighted_loop(vehicle: Vehicle, controller: Controller) -> "control.StateSpace":
    """The same to the weighted output z (34) alone: its norm is the certificate's.

    Each output is a signal times its weight in `[performance]`, and is called `z[signal]`.
    """
    return _loop(vehicle, controller, [f"z[{signal}]" for signal, weight in vehicle.performance.items() if weight > 0])


def _loop(vehicle: Vehicle, controller: Controller, outputs: Sequence[str]) -> "control.StateSpace":
    """The closed loop to a vehicle's z, whose entries are called so."""
    from control import StateSpace, ss

    loop = generalized_plant(vehicle).closed_loop(controller.state_gain(vehicle))
    roads = [wheel.road_velocity for wheel in vehicle.kind.wheels]
    more = [f"road_twist_{k}" for k in range(1, loop.Bw.shape[1] - len(roads) + 1)]
    system = ss(
        loop.A,
        loop.Bw,
        loop.C,
        loop.Dw,
        name=f"{vehicle.kind.name}_{controller.name}",
        states=list(vehicle.linear_model.states),
        inputs=[*roads, *more],
        outputs=list(outputs),
    )
    assert isinstance(system, StateSpace)
    return system


def _single(response: Response) -> None:
    if response.values.ndim != 2:
        raise ValueError(f"the response holds runs of shape {response.values.shape[:-2]}; take one, as in response.run(0)")
