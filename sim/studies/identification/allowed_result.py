"""Results for a controller over all vehicles that are consistent with the logs."""

from dataclasses import dataclass

from models.document.field import Field


@dataclass(frozen=True)
class AllowedResult:
    """Bound on the norm, margins and ride of one controller over the vehicles that are consistent with the logs.

    Attributes:
        name: name of the controller.
        bound: proved bound on the H-infinity norm for the estimated vehicle; None if nothing is proved.
        worst_bound: largest proved bound on the norm over all vehicles; None if nothing is proved for at least one vehicle.
        gain_margin: smallest gain margin over all vehicles; infinite if no change of the gain makes any loop unstable.
        disk_margin: smallest disk margin over all vehicles; None if no vehicle's loop has a disk margin.
        ride: expected ride value of the estimated vehicle on an average road [m/s2]; None if this value cannot be computed.
        worst_ride: largest expected ride value over all vehicles [m/s2].
        vehicles: number of vehicles that are consistent with the logs and were evaluated.
    """

    name: str
    bound: float | None
    worst_bound: float | None
    gain_margin: float
    disk_margin: float | None
    ride: float | None
    worst_ride: float | None
    vehicles: int


WORST_BOUND = Field[AllowedResult]("worst bound", lambda row: row.worst_bound, ".5g", key="worst_bound")
ALLOWED = (
    Field[AllowedResult]("controller", lambda row: row.name, key="controller"),
    Field[AllowedResult]("bound", lambda row: row.bound, ".5g", key="bound"),
    WORST_BOUND,
    Field[AllowedResult]("gain margin", lambda row: row.gain_margin, ".3g", key="gain_margin"),
    Field[AllowedResult]("disk margin", lambda row: row.disk_margin, ".2g", key="disk_margin"),
    Field[AllowedResult]("ride", lambda row: row.ride, ".3g", key="ride", unit="m/s²"),
    Field[AllowedResult]("worst ride", lambda row: row.worst_ride, ".3g", key="worst_ride", unit="m/s²"),
)
