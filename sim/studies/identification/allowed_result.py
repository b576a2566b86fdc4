"""Result of a controller over the vehicles that logs allow."""

from dataclasses import dataclass

from models.document.field import Field


@dataclass(frozen=True)
class AllowedResult:
    """A controller on the vehicles that the logs allow.

    Attributes:
        name: name of the controller.
        bound: proved bound on the norm for the estimate; None without a proof.
        worst_bound: largest proved bound of all vehicles; None if one of them has none.
        gain_margin: smallest gain margin; infinite for no limit.
        disk_margin: smallest disk margin; None without one.
        ride: expected ride of the estimate on an average road [m/s2]; None without one.
        worst_ride: largest of all vehicles [m/s2].
        vehicles: number of vehicles.
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
