"""Problem of an identification: the parameters to identify, the experiments with the logs, and known combinations of
parameters.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property

from models.vehicle.vehicle import Vehicle
from sim.studies.identification.experiment import Experiment
from sim.studies.identification.part_prediction import PartPrediction
from sim.studies.identification.prediction import LogPrediction


@dataclass(frozen=True, eq=False)
class Known:
    """A combination of parameters whose value is known from another source, such as a corner weight or a weighed mass.

    Attributes:
        name: name of the combination in reports.
        of: function that computes the combination [SI] for a vehicle.
        value: measured value of the combination [SI].
        deviation: standard deviation of the measured value [SI].
    """

    name: str
    of: Callable[[Vehicle], float]
    value: float
    deviation: float


@dataclass(frozen=True, eq=False)
class IdentificationProblem:
    """Parameters to identify, and the experiments whose logs are used for the estimate.

    Attributes:
        vehicle: vehicle whose parameters have their initial values.
        change: function that returns the vehicle after some parameter values were changed.
        first: initial values of all free parameters, by name; every value is above 0.
        experiments: experiments whose logs are used to estimate the parameters.
        known: combinations of parameters whose values are known from other sources.
        from_zero: names of the free parameters that may be zero; all other parameters are represented by their logarithms.
        lowest: smallest allowed values of parameters that need a limit above 0 (such as an exponent), by name.
    """

    vehicle: Vehicle
    change: Callable[[Vehicle, Mapping[str, float]], Vehicle]
    first: Mapping[str, float]
    experiments: tuple[Experiment, ...]
    known: tuple[Known, ...] = ()
    from_zero: frozenset[str] = frozenset()
    lowest: Mapping[str, float] = field(default_factory=dict[str, float])

    @cached_property
    def predictions(self) -> tuple[LogPrediction, ...]:
        """The object that predicts the signals of each experiment."""
        return tuple(
            (PartPrediction if one.part else LogPrediction)(one, lambda values: self.change(self.vehicle, values))
            for one in self.experiments
        )

    @cached_property
    def signals(self) -> tuple[str, ...]:
        """Names of all measured signals."""
        return tuple(dict.fromkeys(name for one in self.experiments for name in one.signals))

    @cached_property
    def delayed(self) -> tuple[str, ...]:
        """Names of the signals for which the delay of the sensor is estimated."""
        names = {one.signal for each in self.experiments for one in each.channels if one.delay_estimated}
        return tuple(name for name in self.signals if name in names)
