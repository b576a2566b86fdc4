"""Vehicle models: equations of motion, MuJoCo models, parameters, signal names, roads and control laws.

Start with `read_vehicle`, which reads a vehicle file or a built-in vehicle, and with `choose_road`, which turns a text such as
"bump" into a road. All quantities are in SI units. The following names are public, and each name is imported when it is first
used:

- vehicles: `read_vehicle`, `parse_vehicle`, `Vehicle`
- roads: `Bump`, `Step`, `Pothole`, `WattsHump`, `Flat`, `SineSweep`, `Iso8608`, `Profile`, `Rig`; their base class `Road`; and
  `choose_road`, which reads a road from a text
- custom vehicle types: `VehicleKind`, `Wheel`, `Suspension`, `Parameter`, `Variation`, `LinearModel`, `signals`, `BodyLoad`,
  `Invariant`, `GRAVITY`
- custom linear control laws: `LinearLaw`
- measured signals from a log file: `read_measured_log`
- errors: `InputError`, raised for any invalid input; its message is one line that gives the cause and the correction

Names that are not in this list may be moved or renamed without notice.
"""

from models.common.lazy import attach

USUAL_TIMESTEP = 1e-3  # default timestep of runs [s]; also the default sample period of controllers

TYPE_CHECKING = False
if TYPE_CHECKING:  # imports for type checkers and editors
    from models.common.errors import InputError
    from models.common.logs.measured_log import read_measured_log
    from models.kinds import signals
    from models.kinds.kind import GRAVITY, BodyLoad, Invariant, Parameter, Suspension, Variation, VehicleKind, Wheel
    from models.kinds.linear_model import LinearModel
    from models.laws.linear import LinearLaw
    from models.roads.choice import choose_road
    from models.roads.iso8608 import Iso8608
    from models.roads.obstacles import Flat, Pothole, Step, WattsHump
    from models.roads.profile import Profile
    from models.roads.rig import Rig
    from models.roads.road import Bump, Road
    from models.roads.sinusoids import SineSweep
    from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
else:
    __getattr__, __dir__, __all__ = attach(__name__, __file__)
