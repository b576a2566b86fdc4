"""Ways out: responses and designs as the objects that notebooks start from."""

from typing import TYPE_CHECKING

import numpy as np

from models.vehicle import Vehicle
from sim.response.response import Response

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


def _single(response: Response) -> None:
    if response.values.ndim != 2:
        raise ValueError(f"the response holds runs of shape {response.values.shape[:-2]}; take one, as in response.run(0)")
