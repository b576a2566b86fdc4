"""Extensions by name: what the core of the three packages knows by its name alone, and imports when the name is used.

A row of `EXTENSIONS` is all that the core, help pages, completion and messages know of an extension. Without its row and its file
everything else works.
"""

from collections.abc import Mapping
from typing import Any

from models.common.errors import InputError, alike
from models.common.lazy import named


class Registry(dict[str, str]):
    """Extensions of one sort: the "module:attribute" of each, by name. The order of names is that of columns and messages.

    Attributes:
        sort: what these extensions are, in the singular, for messages.
    """

    def __init__(self, sort: str, rows: Mapping[str, str]) -> None:
        super().__init__(rows)
        self.sort = sort

    def load(self, name: str) -> Any:
        """Returns what a name stands for; its module is imported now.

        Raises:
            InputError: no extension of this sort has that name.
        """
        if name not in self:
            raise InputError(f"{self.sort} {name!r} is not known; known are {alike(name, self)}")
        return named(self[name])


_STANDARD = "sim.studies.ride.kinds.standard"
_ROWS = {
    "part": {  # a class, see `models.parts.part`
        "stop": "models.parts.stop:Stops",
        "spring": "models.parts.spring:SpringCurve",
        "damper": "models.parts.damper:DamperCurve",
        "surface damper": "models.parts.surface_damper:SurfaceDamper",
        "adjustable damper": "models.parts.adjustable:Adjustable",
        "actuator": "models.parts.actuator:Actuator",
        "hydraulic_stop": "models.parts.elements.hydraulic_stop:HydraulicStop",
        "gas_spring": "models.parts.elements.gas_spring:GasSpring",
        "maxwell": "models.parts.elements.maxwell:Maxwell",
        "inerter": "models.parts.elements.inerter:Inerter",
        "bouc_wen": "models.parts.elements.bouc_wen:BoucWen",
        "modified_bouc_wen": "models.parts.elements.modified_bouc_wen:ModifiedBoucWen",
        "dahl": "models.parts.elements.dahl:Dahl",
    },
    "design method": {  # a function, see `synth.design.methods`
        "two_steps": "synth.design.two_step:two_steps",
        "state": "synth.design.two_step:state",
        "zero_l": "synth.design.two_step:zero_l",
        "descent": "synth.design.fallback:descent",
        "refinement": "synth.design.fallback:refinement",
        "structured": "synth.design.fixed_order.fixed_order:structured",
        "riccati": "synth.design.full_order.full_order:riccati",
        "goals": "synth.design.multi_objective.design:for_goals",
        "sampled": "synth.design.sampled_data:sampled",
        "mu": "synth.design.uncertainty.robust_design:mu",
        "lqr": "synth.design.full_order.quadratic:quadratic",
        "lqg": "synth.design.full_order.quadratic:quadratic",
        "h2": "synth.design.full_order.quadratic:quadratic",
        "preview": "synth.design.full_order.preview:preview",
    },
    "section": {  # what reads a section of a vehicle file
        "controllers": "models.vehicle.controller_section:ControllerSection",
        "limits of places": "models.characteristics.stops:read_places",
        "stop table": "models.characteristics.stops:read_stop_table",
        "table of a stop": "models.characteristics.curve_reading:StopTableSection",
    },
    "calculation": {  # a function that the core calls only for what a vehicle file or a command asks
        "stops of a corner": "models.characteristics.stops:stops_at",
        "stops in words": "models.characteristics.stops:stop_words",
        "stops that a run reaches": "sim.runs.stops:stops_object",
        "hardest contact with stops": "sim.runs.stops:stop_note",
        "stops reached at a time": "sim.runs.stops:stop_names",
        "effect of exported code": "sim.runs.code_effect:code_effect",
        "lower bound": "synth.lmi.full_order_bound:find_lower_bound",
        "bound beyond control": "synth.lmi.full_order_bound:bound_beyond_control",
        "remove unobservable states": "synth.lmi.unobservable:remove_unobservable",
        "barrier of a large path": "synth.lmi.structured_barrier:path_barrier",
        "barrier of a large start": "synth.lmi.structured_barrier:start_barrier",
    },
    "driver": {  # what makes the driver of (controllers, failures, numbers), see `sim.drive.drivers.registry`
        "linear": "sim.drive.drivers.linear:LinearDriver",
        "semi_active": "sim.drive.drivers.semi_active:SemiActiveDriver",
        "python": "sim.drive.drivers.python:in_python",
        "recorded": "sim.drive.drivers.recorded:RecordedDriver",
        "code": "sim.drive.drivers.code:CodeDriver",
    },
    "observer": {  # a class for batches, see `sim.drive.drive.Observer`, or a function of a recording
        "energy": "sim.observers.energy:energy",
        "steps": "sim.observers.steps:compare_steps",
        "commands": "sim.observers.commands:compare_commands",
        "twin": "sim.observers.twin:Twin",
        "growth": "sim.observers.growth:Growth",
    },
    "metric": {  # a class; its name is its key in `--best` and in the table of controllers, whose columns have this order
        "dive": f"{_STANDARD}:Dive",
        "squat": f"{_STANDARD}:Squat",
        "roll": f"{_STANDARD}:Roll",
        "final_angle": f"{_STANDARD}:FinalAngle",
        "rms_acceleration": f"{_STANDARD}:RmsAcceleration",
        "ride": f"{_STANDARD}:Weighted",
        "vdv": f"{_STANDARD}:VibrationDose",
        "mtvv": f"{_STANDARD}:TransientVibration",
        "crest": f"{_STANDARD}:Crest",
        "rms_travel": f"{_STANDARD}:RmsTravel",
        "peak_travel": f"{_STANDARD}:PeakTravel",
        "dynamic_load": f"{_STANDARD}:DynamicLoad",
        "off_ground": f"{_STANDARD}:OffGround",
        "force_rms": f"{_STANDARD}:RmsForce",
        "force_peak": f"{_STANDARD}:PeakForce",
        "power": f"{_STANDARD}:ControlPower",
        "energy": f"{_STANDARD}:ControlEnergy",
        "at_stops": f"{_STANDARD}:AtStops",
    },
}
EXTENSIONS = {sort: Registry(sort, rows) for sort, rows in _ROWS.items()}
PARTS, METHODS, SECTIONS, CALCULATIONS, DRIVERS, OBSERVERS, METRICS = EXTENSIONS.values()
