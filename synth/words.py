"""A controller, and what there is to say of its design, in words."""

from collections.abc import Sequence

import numpy as np

from models.common.arrays import Array
from models.common.numbers import percent
from models.common.printed import matrix
from models.controllers import IDEAL
from models.curves.fitted import lines_at_rest
from models.law import LinearLaw
from models.signals import HEAVE_LOAD, PITCH_LOAD, ROLL_LOAD
from models.vehicle import Vehicle
from synth.controller import Controller

IDEAL_LOOP = "of the ideal loop, continuous and without [limits] and [implementation]"
SETTLED = 1e-2  # relative: a gain that moves less over the last hundredfold of mu is within 1e-4 of the limit
SHORT = 1e-6  # relative in gamma; less is the path's own end
UNITS = {one.name: one.unit for one in (HEAVE_LOAD, PITCH_LOAD, ROLL_LOAD)}


def heading_lines(controller: Controller) -> list[str]:
    """What a controller measures, and its gain."""
    measures = f"controller {controller.name}: measures {', '.join(controller.measured) or 'nothing'}"
    if not controller.measured:
        return [measures, "  no control force"]
    return [measures, *law_lines(controller.law, "  gain ", "  law ")]


def law_lines(law: LinearLaw, gain: str, of_states: str) -> list[str]:
    """A law after some text: a static one as its gain, a row to a line, others by their states and poles."""
    if not law.states:
        return gain_lines(law.D, gain)
    if law.sample_period is None:
        return [f"{of_states}x_c' = A x_c + B y, u = C x_c + D y, of {states_text(law)}"]
    return [f"{of_states}x_c[i+1] = A x_c[i] + B y[i], u[i] = C x_c[i] + D y[i], of {states_text(law)}"]


def states_text(law: LinearLaw) -> str:
    """How many states a law has, and where its poles lie."""
    poles = np.linalg.eigvals(law.A)
    count = f"{law.states} states" if law.states > 1 else "1 state"
    if law.sample_period is not None:
        pole = "its largest pole" if law.states > 1 else "its pole"
        return f"{count}, every {1e3 * law.sample_period:g} ms; {pole} {np.abs(poles).max():.4g}"
    least, most = (f"{rate:.4g}" for rate in (np.abs(poles).min(), np.abs(poles).max()))
    where = f"poles of {least} to {most}" if least != most else f"{'poles' if law.states > 1 else 'its pole'} of {least}"
    unstable = ", not all stable" if poles.real.max() > 0 else ""
    return f"{count}; {where} rad/s{unstable}"


def gain_lines(gain: Array, start: str) -> list[str]:
    """A gain matrix after some text, a row to a line."""
    return matrix(start, [[f"{entry:.6g}" for entry in row] for row in gain])


def twist_lines(vehicle: Vehicle) -> list[str]:
    """What else than the road's velocity a norm is of, where a road acts by its height, too."""
    model = vehicle.linear_model
    if not np.any(model.Br) and not np.any(model.Cr):
        return []
    return [
        "w is the road's velocity under every wheel and, as no car forgets it, the height of its twist, of which 1 m counts as "
        f"{model.twist_rate:.4g} m/s (models/README.md)"
    ]


def ideal_lines(vehicle: Vehicle, controllers: Sequence[Controller]) -> list[str]:
    """Which loop the numbers of these controllers are of, where the vehicle file has another one, too."""
    asked = [one.name for one in controllers if one.hardware != IDEAL]
    what = "noise, lag and loads" if any(one.hardware.loads for one in controllers) else "noise and lag"
    but = f", but for the {what} that {', '.join(asked)} {'ask' if len(asked) > 1 else 'asks'} for" if asked else ""
    found = [] if vehicle.ideal else [f"bound, norm and poles are {IDEAL_LOOP}{but}"]
    if vehicle.dampers and any(one.law.acts for one in controllers):
        lag = ", and know no lag of their valves" if any(one.damper.bandwidth for one in vehicle.adjustable) else ""
        found.append(
            f"bound, norm and poles are of forces that are given: they hold only while the adjustable dampers give them{lag}"
        )
    if slopes := lines_at_rest(vehicle.fitted):
        found.append(f"bound, norm and poles are of the lines of [curves] at rest: {slopes}")
    return found


def filter_lines(vehicle: Vehicle) -> list[str]:
    """What filters are in z and in w, where there are any, and whose poles theirs are."""
    if not vehicle.filtered:
        return []
    found = [f"{signal} through {one.words}" for signal, one in vehicle.filters.items()]
    found += [f"the road's velocity from w through {vehicle.road_filter.words}"] if vehicle.road_filter is not None else []
    return [f"norms are of {', '.join(found)}; their poles are in every loop, no control moves them, and they are left out"]


def judged_lines(controller: Controller) -> list[str]:
    """What a controller's norm and bounds are of, where that is more than its law on the vehicle."""
    measured, hardware = controller.measured, controller.hardware
    pairs = zip(measured, hardware.noise, strict=bool(hardware.noise))
    noise = ", ".join(f"{rms:g} on {name}" for name, rms in pairs if rms)
    found = []
    if noise:
        found.append(
            f"norm and bounds are of road and noise together: a noise of {noise} counts as much as 1 m/s of w, which is the "
            "road's velocity, or what its filter shapes it from"
        )
    if hardware.loads:
        loads = ", ".join(f"{value:g} {UNITS[name]} of {name}" for name, value in hardware.loads)
        found.append(
            f"norm and bounds are of road and loads together: {loads} count as much as 1 m/s of w each; a norm as implemented, "
            "and one that sim.sweep measures, is of the road alone"
        )
    if controller.law.states and controller.law.sample_period is not None:
        found.append("norm, bounds and poles are of its continuous counterpart, whose bilinear transform (Tustin) it is")
    if hardware.bandwidth is not None:
        found.append(
            f"norm, bounds and poles are with the actuators' lag, {hardware.bandwidth:g} rad/s; the force that z weighs is the "
            "one asked for"
        )
    return found


def notes(controller: Controller) -> tuple[str, ...]:
    """What is the case where there is no one optimum, what was done instead, how far from it a design is, what is in vain."""
    found = [*judged_lines(controller), *(text for text in (controller.case, controller.instead, *controller.remarks) if text)]
    if controller.state_step_gap > SHORT:
        gap = percent(controller.state_step_gap)
        found.append(f"from an X {gap} short of the best state feedback; from the best there is no design")
    if controller.optimum_gap > SHORT:
        gap = percent(controller.optimum_gap)
        found.append(f"bound {gap} short of the optimum, which only a gain beyond any actuator reaches")
    elif controller.moved > SETTLED:
        found.append(
            f"gain not settled: over the last step of its path it moved by {percent(controller.moved)} of its largest entry, so "
            "that its digits are not those of the optimum; the norm and its bound hold for it as it is"
        )
    if controller.redundant:
        found.append(f"measures in vain: {', '.join(controller.redundant)} follows from the other signals and is given no gain")
    return tuple(found)


def gain_text(gain: Array) -> str:
    """A gain matrix on one line, as a vehicle file has it."""
    return "[" + ", ".join("[" + ", ".join(f"{entry:.6g}" for entry in row) + "]" for row in gain) + "]"
