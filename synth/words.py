"""A controller, and what there is to say of its design, in words."""

from models.common.arrays import Array
from models.common.printed import matrix
from models.vehicle import Vehicle
from synth.controller import Controller

IDEAL_LOOP = "of the ideal loop, continuous and without [limits] and [implementation]"
SETTLED = 1e-2  # relative: a gain that moves less over the last hundredfold of mu is within 1e-4 of the limit
SHORT = 1e-6  # relative in gamma; less is the path's own end


def heading_lines(controller: Controller) -> list[str]:
    """What a controller measures, and its gain."""
    measures = f"controller {controller.name}: measures {', '.join(controller.measured) or 'nothing'}"
    if not controller.measured:
        return [measures, "  no control force"]
    return [measures, *gain_lines(controller.gain, "  gain ")]


def gain_lines(gain: Array, start: str) -> list[str]:
    """A gain matrix after some text, a row to a line."""
    return matrix(start, [[f"{entry:.6g}" for entry in row] for row in gain])


def ideal_lines(vehicle: Vehicle) -> list[str]:
    """Which loop the numbers are of, where the vehicle file has another one, too."""
    return [] if vehicle.ideal else [f"bound, norm and poles are {IDEAL_LOOP}"]


def notes(controller: Controller) -> tuple[str, ...]:
    """What is the case where there is no one optimum, what was done instead, how far from it a design is, what is in vain."""
    found = [text for text in (controller.case, controller.instead) if text]
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


def percent(share: float) -> str:
    """A share in percent; what rounding leaves is 0."""
    if share <= 1e-9:
        return "0 %"
    return f"{100 * share:.2g} %" if share < 0.995 else f"{100 * share:.0f} %"


def gain_text(gain: Array) -> str:
    """A gain matrix on one line, as a vehicle file has it."""
    return "[" + ", ".join("[" + ", ".join(f"{entry:.6g}" for entry in row) + "]" for row in gain) + "]"
