"""Notes about designs that only the commands of `synth` and studies print: gains of PI and PID laws, and the warp of the road."""

from models.common.errors import list_names
from models.common.extensions import FEATURES
from models.common.printed import rough
from models.vehicle.vehicle import Vehicle
from synth.controller.controller import Controller
from synth.controller.problem import road_twist_inputs


def pid_line(controller: Controller) -> str:
    """Formats the gains of a designed PI or PID law in the syntax of a vehicle file; returns an empty text for other laws."""
    pid = FEATURES.load("PID laws")
    remarked = (remark.partition(pid.ITS_GAINS)[2].partition("; ")[0] for remark in controller.remarks)
    return next(filter(None, remarked), "") or pid.pid_text(controller.law)


def sign_note(controller: Controller) -> str:
    """Returns a note about the signs of the gains if a PI or PID law with a positive gain makes the loop unstable; else empty."""
    if controller.certificate.stable or not controller.law.states:
        return ""
    pid = FEATURES.load("PID laws")
    if not any(gains.get(name, 0.0) > 0 for gains in pid.pid_gains(controller.law) for name in pid.GAINS):
        return ""
    return "; a positive kp, ki or kd lifts the body, which increases an extension: give negative gains to oppose it"


def twist_lines(vehicle: Vehicle) -> list[str]:
    """Returns a note about road warp, which is a separate disturbance, if the warp affects the vehicle."""
    count, rate = len(road_twist_inputs(vehicle.linear_model)), rough(vehicle.linear_model.twist_rate)
    # If the body has a roll or pitch axis, its weight acts in proportion to the inclination of the road.
    axes = {"roll_centre_height_front": "roll", "roll_centre_height": "roll", "pitch_centre_height": "pitch"}
    felt = [way for parameter, way in axes.items() if parameter in vehicle.parameters]
    felt += ["twist"] if count > len(felt) else []
    text = f"The disturbance w is the road's velocity under every wheel and the height of the road's {list_names(felt)}"
    return [f"{text}; 1 m of this height counts as {rate} m/s of road velocity."] if count else []
