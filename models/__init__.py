"""Models of vehicles: equations, MJCF and parameters, side by side, and the names of all signals.

Public names, imported when they are first used; all units are SI:

- vehicles: `read_vehicle`, `parse_vehicle`, `Vehicle`
- roads: `Bump`, `Step`, `Pothole`, `WattsHump`, `Flat`, `SineSweep`, `Iso8608`, `Profile`, `Rig`; `Road` is their common
  base, and `choose_road` reads them as text
- a kind of vehicle of your own: `VehicleKind`, `Wheel`, `Suspension`, `Parameter`, `Variation`, `LinearModel`, `signals`,
  `BodyLoad`, `Invariant`, `GRAVITY`
- a law of your own: `LinearLaw`
- measured signals from a file: `read_measured_log`
- bad input of any kind: `InputError`, whose message is one line with the cause and the repair

All other names may move without notice.
"""

from models.common.lazy import attach

USUAL_TIMESTEP = 1e-3  # s, of a run, and so a controller's sample period by default

TYPE_CHECKING = False
if TYPE_CHECKING:  # what type checkers and editors see
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
