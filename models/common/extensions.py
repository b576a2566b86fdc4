"""Extensions by name. The core of the three packages knows only the names of the extensions, and imports an extension when its
name is used.

The core, help pages, completion and messages use only the rows of `EXTENSIONS`. If the row and the file of an extension are
removed, everything else still works.
"""

from collections.abc import Mapping
from typing import Any

from models.common.errors import InputError, alike
from models.common.lazy import resolve_name


class Registry(dict[str, str]):
    """Registry of the extensions of one type, by the name of the extension. The value that belongs to a name is
    "module:attribute" or the name of a module.

    The columns, sections and messages of extensions appear in the order of the names in the registry.

    Attributes:
        sort: noun for an extension of this type, for messages.
        attributes: names of the attributes that each extension of this type must have.
        texts: additional texts for help pages, by the name of the extension.
    """

    def __init__(self, sort: str, rows: Mapping[str, str | tuple[str, ...]], attributes: tuple[str, ...] = ()) -> None:
        each = {name: (row,) if isinstance(row, str) else row for name, row in rows.items()}
        super().__init__({name: row[0] for name, row in each.items()})
        self.sort, self.attributes, self.texts = sort, attributes, {name: row[1:] for name, row in each.items()}

    def load(self, name: str) -> Any:
        """Imports and returns the extension with a given name.

        Raises:
            InputError: no extension has the given name.
            TypeError: the extension lacks one of the required attributes.
        """
        if name not in self:
            raise InputError(f"{self.sort} {name!r} is not known; give one of {alike(name, self)}")
        extension = resolve_name(self[name])
        for attribute in self.attributes:
            if not hasattr(extension, attribute):
                raise TypeError(f"{self.sort} {name!r}: {self[name]} has no {attribute}")
        return extension

    def load_if_known(self, name: str) -> Any:
        """Returns the extension with a given name; None if the registry does not contain the name."""
        return self.load(name) if name in self else None

    def load_all(self) -> dict[str, Any]:
        """Returns all extensions by name, in the order of the rows of the registry."""
        return {name: self.load(name) for name in self}


_STANDARD = "sim.studies.ride.kinds.standard"
_FREQUENCY, _VALIDITY = "sim.studies.frequency.study", "sim.studies.validity.study"
_RECOMMEND = "sim.studies.recommend.command"
_ROWS: dict[str, dict[str, str | tuple[str, ...]]] = {
    "part": {  # the values are classes, see `models.parts.part`
        "stop": "models.parts.stops.part:Stops",
        "spring": "models.parts.spring:SpringCurve",
        "damper": "models.parts.damper:DamperCurve",
        "surface damper": "models.parts.surface_damper:SurfaceDamper",
        "adjustable damper": "models.parts.adjustable:Adjustable",
        "actuator": "models.parts.actuator:Actuator",
        "hydraulic_stop": "models.parts.stops.hydraulic_stop:HydraulicStop",
        "gas_spring": "models.parts.elements.gas_spring:GasSpring",
        "maxwell": "models.parts.elements.maxwell:Maxwell",
        "inerter": "models.parts.elements.inerter:Inerter",
        "bouc_wen": "models.parts.elements.bouc_wen:BoucWen",
        "modified_bouc_wen": "models.parts.elements.modified_bouc_wen:ModifiedBoucWen",
        "dahl": "models.parts.elements.dahl:Dahl",
    },
    "design method": {  # the values are functions, see `synth.design.methods`
        "two_steps": "synth.design.two_step:two_steps",
        "state": "synth.design.two_step:state",
        "zero_l": "synth.design.two_step:zero_l",
        "descent": "synth.design.fallback:descent",
        "refinement": "synth.design.fallback:refinement",
        "structured": "synth.design.fixed_order.fixed_order:design_structured",
        "riccati": "synth.design.full_order.full_order:riccati",
        "goals": "synth.design.multi_objective.design:for_goals",
        "sampled": "synth.design.sampled_data:design_sampled",
        "mu": "synth.design.uncertainty.robust_design:mu",
        "lqr": "synth.design.full_order.quadratic:quadratic",
        "lqg": "synth.design.full_order.quadratic:quadratic",
        "h2": "synth.design.full_order.quadratic:quadratic",
        "preview": "synth.design.full_order.preview:preview",
    },
    "feature": {  # modules whose public names are not part of the core: functions for vehicle files, commands and results
        "adjustable dampers": "models.characteristics.adjustable_range",
        "curves": "models.characteristics.curve",
        "curves in files": "models.characteristics.curve_reading",
        "measured loops": "models.characteristics.measured_loop",
        "motion ratios over travel": "models.characteristics.ratio_table",
        "stops": "models.parts.stops.stop",
        "surfaces": "models.characteristics.surface",
        "editing of TOML": "models.common.toml_edit",
        "figures in notebooks": "models.document.notebook",
        "pages": "models.document.page",
        "pictures": "models.document.picture",
        "doubts about numbers": "models.kinds.plausibility",
        "seats": "models.kinds.seated_kind",
        "vehicle types in Python": "models.kinds.user_kind",
        "anti-windup": "models.laws.anti_windup",
        "combinations of options": "models.laws.combinations",
        "PID laws": "models.laws.law_structure",
        "damper ranges": "models.parts.damper_range",
        "parts in files": "models.parts.element",
        "curves of suspensions": "models.parts.curves",
        "lines of parts": "models.parts.lines",
        "parts native to MuJoCo": "models.parts.native",
        "doubts about parts": "models.parts.plausibility",
        "parts at motion ratios": "models.parts.ratio",
        "parts": "models.parts.placement",
        "settable parts": "models.parts.settable",
        "roads by name": "models.roads.choice",
        "loads by name": "models.roads.loads.choice",
        "IRI": "models.roads.iri",
        "measured roads": "models.roads.profile",
        "rigs": "models.roads.rig",
        "all keys of controllers": "models.vehicle.controller_section",
        "files named in vehicle files": "models.vehicle.in_place",
        "payload": "models.vehicle.payload",
        "weights with filters": "models.vehicle.weights",
        "semi-active coefficients": "models.vehicle.semi_active_coefficients",
        "discrete plants": "synth.plant.discrete",
        "bounds by Riccati equations": "synth.analysis.bounding",
        "norms with twice the precision": "synth.analysis.twice_precision",
        "obstacles to stabilisation": "synth.analysis.stabilisability",
        "zeros": "synth.analysis.lower_bounds.interpolation",
        "sampled norm": "synth.analysis.sampled_norm",
        "exported code": "synth.controller.export.folder",
        "norms of sampled loops": "synth.controller.sampled_report",
        "norm as implemented": "synth.controller.implementation_norm",
        "filters in plants": "synth.controller.filtered_plant",
        "measured heights": "synth.controller.measured_heights",
        "integral action": "synth.controller.integral_action",
        "degenerate plants": "synth.design.degenerate",
        "lower bounds": "synth.lmi.full_order_bound",
        "certificates as data": "synth.analysis.record",
        "bounds of sampled loops": "synth.lmi.sampled_bound",
        "large plants": "synth.lmi.structured_barrier",
        "unobservable states": "synth.lmi.unobservable",
        "changes since a certificate": "synth.vehicle.certified_vehicle",
        "goals": "synth.vehicle.multi_objective",
        "mean square designs": "synth.vehicle.mean_square",
        "refinement": "synth.vehicle.refined",
        "weighted errors": "synth.vehicle.weighted_errors",
        "viewers": "sim.command.viewer",
        "parts in MuJoCo": "sim.drive.part_steps",
        "scene of a log": "sim.recording.foxglove_scene",
        "dampers in linear analysis": "sim.linear.dampers",
        "response to given forces": "sim.linear.forced_response",
        "preview in continuous loops": "sim.linear.preview_response",
        "stepped response": "sim.linear.stepped",
        "effect of exported code": "sim.runs.code_effect",
        "forces that dampers lack": "sim.runs.dampers",
        "decay": "sim.runs.decay",
        "force diagrams": "sim.runs.force_diagram",
        "forces of parts": "sim.runs.forces",
        "recorded logs": "sim.inspect.log",
        "signals as CSV": "sim.runs.signal_table",
        "start of a run": "sim.runs.start",
        "stops that a run reaches": "sim.runs.stops",
        "time histories": "sim.runs.time_histories",
        "ride of a run": "sim.studies.ride.run_metrics",
        "step response": "sim.studies.ride.step_response",
        "comparison with a measured log": "sim.studies.validity.measured_log",
    },
    # The values are functions or classes that create a driver from the arguments (controllers, failures, numbers); see
    # `sim.drive.drivers.registry`
    "driver": {
        "linear": "sim.drive.drivers.linear:LinearDriver",
        "semi_active": "sim.drive.drivers.semi_active:SemiActiveDriver",
        "python": "sim.drive.drivers.python:in_python",
        "recorded": "sim.drive.drivers.recorded:RecordedDriver",
        "code": "sim.drive.drivers.code:CodeDriver",
    },
    # The values are classes that observe a batch of runs, see `sim.drive.drive.Observer`, or functions of a recording
    "observer": {
        "energy": "sim.observers.energy:energy",
        "steps": "sim.observers.steps:compare_steps",
        "commands": "sim.observers.commands:compare_commands",
        "twin": "sim.observers.twin:Twin",
        "growth": "sim.observers.growth:Growth",
    },
    # The values are functions (path, runs, metadata) that write another file next to the MCAP file of a log; the suffix of the
    # file follows. The name is the file's key in `--json`
    "recording": {
        "layout": ("sim.recording.foxglove_layout:write_layout", "layout.json"),
        "rerun": ("sim.recording.rerun_writer:write_rrd", "rrd"),
    },
    # The values are classes. The name of a metric is its key in `--best` and in the table of controllers; the columns of this
    # table have the order of the names here
    "metric": {
        "dive": f"{_STANDARD}:Dive",
        "squat": f"{_STANDARD}:Squat",
        "roll": f"{_STANDARD}:Roll",
        "final_angle": f"{_STANDARD}:FinalAngle",
        "rms_acceleration": f"{_STANDARD}:RmsAcceleration",
        "ride": f"{_STANDARD}:WeightedRms",
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
    # The first value is the class of a study; for a study that is a command, its purpose and main options follow, see
    # `sim.studies.study`
    "study": {
        "designs": "sim.report.designs:DesignsStudy",
        "sweep": (f"{_FREQUENCY}:SweepStudy", "measure frequency responses and the H-infinity norm", "--amplitude --picture"),
        "response": "sim.report.agreement:ResponseStudy",
        "agreement": "sim.report.agreement:AgreementStudy",
        "ends": f"{_VALIDITY}:EndsStudy",
        "margins": ("sim.studies.stability.study:MarginsStudy", "find the gain, delay and sample-period margins", "--picture"),
        "envelope": (f"{_VALIDITY}:EnvelopeStudy", "map the bumps over which linear analysis is valid", "--vary --picture --csv"),
        "recommend": (
            f"{_RECOMMEND}:RecommendStudy",
            "recommend a controller for a vehicle and its road",
            "--class --within --save",
        ),
        "ride": "sim.studies.ride.over_roads:RideStudy",
        "workshop": f"{_FREQUENCY}:WorkshopStudy",
        "loads": "sim.studies.ride.loads:LoadsStudy",
        "exported": "sim.report.exported:ExportedStudy",
        "front": "sim.studies.frequency.trade_off:FrontStudy",
        "paper": "sim.report.designs:PaperStudy",
        "gallery": ("sim.studies.gallery.command:GalleryStudy", "compare with published results", "NAME"),
        "identify": (
            "sim.studies.identification.command:IdentifyStudy",
            "identify a vehicle from measured logs",
            "LOG --signals --out",
        ),
    },
}
_ATTRIBUTES = {"metric": ("what", "unit", "of", "over_runs")}  # the default `over_runs` does not combine a metric over runs
EXTENSIONS = {sort: Registry(sort, rows, _ATTRIBUTES.get(sort, ())) for sort, rows in _ROWS.items()}
PARTS, METHODS, FEATURES, DRIVERS, OBSERVERS, RECORDINGS, METRICS, STUDIES = EXTENSIONS.values()
