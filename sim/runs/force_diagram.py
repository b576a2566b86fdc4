"""Damper and spring diagrams: the force of a suspension against velocity or deflection, with the characteristic or limits of
the force.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from models.common.arrays import Array
from models.document.figure import Dash
from models.kinds.signals import Signal
from models.parts.damper_range import range_of
from models.vehicle.suspension_forces import MotionRatios
from models.vehicle.vehicle import Vehicle
from sim.drive.response import Response

if TYPE_CHECKING:
    from models.parts.part import SettablePart, SuspensionPart

PREFIX = "suspension_deflection"  # the names of suspension deflections in the built-in vehicle types begin with this text


@dataclass(frozen=True, eq=False)
class Line:
    """Line in a force diagram: a characteristic or a limit.

    Attributes:
        signal: log signal that contains the force of this line, evaluated at the run's velocities or deflections.
        label, dash, width: label and style of the line.
        force: function that returns the force of this line [N] for an array of velocities or deflections.
    """

    signal: Signal
    label: str
    dash: Dash
    width: float
    force: Callable[[Array], Array]


@dataclass(frozen=True, eq=False)
class Diagram:
    """Diagram of a force against the velocity or deflection on which it depends (its argument).

    Attributes:
        title: title that names the vehicle parameter or damper, and where in the vehicle it is.
        over: name and unit of the argument (velocity or deflection) against which the force is plotted.
        argument, pull: log signals that contain the argument and the force.
        x: function that returns the values of the argument in a response, shape (T,).
        force: function that returns the force [N] from the argument and a response, positive if the force contracts the
            suspension, shape (T,).
        lines: lines to draw in the diagram.
    """

    title: str
    over: str
    argument: Signal
    pull: Signal
    x: Callable[[Response], Array]
    force: Callable[[Array, Response], Array]
    lines: tuple[Line, ...]


def diagrams(vehicle: Vehicle) -> list[Diagram]:
    """Returns the diagrams of a vehicle's characteristics, followed by the diagrams of its semi-active dampers."""
    adjusted = {vehicle.kind.deflection_of(adjustable.force) for adjustable in vehicle.parts.adjustable}
    alone = [fitted for fitted in vehicle.parts.with_curve if not fitted.damps or fitted.deflection not in adjusted]
    of_adjustable = [_of_adjustable(vehicle, adjustable) for adjustable in vehicle.parts.adjustable]
    return [*(_of_curve(vehicle, fitted) for fitted in alone), *of_adjustable]


def diagram_signals(vehicle: Vehicle, physics: Response) -> Response | None:
    """Computes the signals of all force diagrams over time from a response; None if the vehicle has no diagrams.

    Each diagram plots a force, and the characteristic or limits of this force, against velocity or deflection.
    """
    signals: list[Signal] = []
    values: list[Array] = []
    for diagram in diagrams(vehicle):
        x = diagram.x(physics)
        signals += [diagram.argument, diagram.pull, *(line.signal for line in diagram.lines)]
        values += [x, diagram.force(x, physics), *(line.force(x) for line in diagram.lines)]
    return Response(physics.time, tuple(signals), np.stack(values, axis=-1)) if signals else None


def _of_curve(vehicle: Vehicle, one: "SuspensionPart") -> Diagram:
    signal = vehicle.kind.signal(one.argument)
    actuator, damper, ratios = one.place.force, one.damps, MotionRatios([vehicle])
    pushed = damper and not one.element and actuator in vehicle.linear_model.inputs
    words = signal.name.replace("_", " ")
    what, ending = one.element or ("damper" if damper else "spring"), _suspension_suffix(one.deflection)

    def force(x: Array, response: Response) -> Array:
        pull = one.part.pull(*((response[one.deflection], x) if damper else (x, np.zeros_like(x))))
        return pull - ratios.of(actuator, response[one.deflection]) * response[actuator] if pushed else pull

    return Diagram(
        f"{one.name.replace('_', ' ')}, {words}",
        f"{words} [{signal.unit}]",
        _diagram_signal(what, "velocity" if damper else "deflection", ending, signal.unit, "positive in extension"),
        _diagram_signal(
            what,
            "force",
            ending,
            "N",
            "with its actuator's, positive in contraction" if damper else "positive in contraction",
        ),
        lambda response: response[signal.name],
        force,
        (
            _line(what, ending, "curve", "solid", 1.8, one.curve),
            _line(what, ending, "line at rest", "dash", 1.0, lambda x: one.curve.slope * x),
        ),
    )


def _of_adjustable(vehicle: Vehicle, one: "SettablePart") -> Diagram:
    from sim.linear.dampers import stretching_rates

    model = vehicle.linear_model
    row = stretching_rates(vehicle)[model.inputs.index(one.force)]
    place = one.ending.replace("_", " ")
    elements = {model.inputs[other.column]: other for other in range_of([vehicle]).elements}
    labels, line = ("c_min", "c_max"), one.nominal

    def force(x: Array, response: Response) -> Array:
        return one.force_at(x, 0.0) - response[one.force]

    if (element := elements.get(one.force)) is not None:
        labels, line = ("lowest voltage", "largest voltage"), float(element.element.line.damping)

        def force(x: Array, response: Response) -> Array:
            return element.element.pull(*element.motion(lambda name: response[name])) - response[one.force]

    return Diagram(
        f"adjustable damper{place}",
        f"{'suspension' if one.ratio == 1 else 'damper'} velocity{place} [m/s]",
        _diagram_signal("damper", "velocity", one.ending, "m/s", "positive in extension"),
        _diagram_signal("damper", "force", one.ending, "N", "total force, positive in contraction"),
        lambda response: (
            np.stack([response[name] for name in model.states], axis=-1)
            @ row
            * MotionRatios([vehicle]).turn(one.force, response[vehicle.kind.deflection_of(one.force)])
        ),
        force,
        (
            _line("damper", one.ending, labels[0], "solid", 1.8, lambda x: one.force_at(x, one.low)),
            _line("damper", one.ending, labels[1], "solid", 1.8, lambda x: one.force_at(x, one.high)),
            _line("damper", one.ending, "line at rest", "dash", 1.0, lambda x: line * x),
        ),
    )


def _suspension_suffix(deflection: str) -> str:
    """Returns the suffix that distinguishes the signal names of a suspension from those of other suspensions."""
    return deflection.removeprefix(PREFIX) if deflection.startswith(PREFIX) else f"_{deflection}"


def _diagram_signal(what: str, quantity: str, ending: str, unit: str, meaning: str) -> Signal:
    place = ending.replace("_", " ")
    return Signal(f"{what}_{quantity}{ending}", f"{quantity.replace('_', ' ')}{place}", unit, f"{what}{place}: {meaning}")


def _line(what: str, ending: str, label: str, dash: Dash, width: float, force: Callable[[Array], Array]) -> Line:
    signal = _diagram_signal(what, f"force_{label.replace(' ', '_')}", ending, "N", f"force of the {label} at the actual motion")
    return Line(signal, label, dash, width, force)
