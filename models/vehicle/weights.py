"""Weights in `[performance]` that are sections: filters, weighted sums of signals, and integrals.

Not all controllers and options of a vehicle file can be combined with a weight that has an integrator.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Annotated, Any, ClassVar

from models.common.errors import InputError, list_names, short_repr
from models.common.schema import HERE, ReadBy
from models.kinds.kind import is_number
from models.laws.filter import Filter, FilterSection
from models.vehicle.controllers import ControllerEntry
from models.vehicle.performance import WEIGHT

FACTORS = "factors of the signals in a weighted sum"
SAMPLED_REFUSAL = "a sampled controller drives only the sum of its samples to zero, so the norm of the integral is not finite"


def _terms(value: Any, context: Mapping[str, Any]) -> dict[str, float]:
    """Returns the factors by which the signals in a sum are multiplied. `context["outputs"]` contains the names of the output
    signals.
    """
    outputs = context["outputs"]
    if not isinstance(value, Mapping) or not value or not all(is_number(one) and one for one in value.values()):
        raise InputError(
            f"{HERE} = {short_repr(value)} is not allowed; give signals with factors other than 0, as in sum = "
            f"{{ {outputs[0]} = 1.0, {outputs[1]} = -1.0 }}"
        )
    if unknown := [signal for signal in value if signal not in outputs]:
        raise InputError(f"{HERE} has the unknown signal {unknown[0]!r}; the signals are {list_names(outputs)}")
    return {signal: float(one) for signal, one in value.items()}


@dataclass(frozen=True)
class WeightSection(FilterSection):
    """Section of a signal or of a sum of signals in `[performance]`. If the key has a number instead of a section, the number
    is the weight.
    """

    integrates: ClassVar[bool] = True

    weight: Annotated[float, WEIGHT] = 1.0
    sum: Annotated[Mapping[str, float], ReadBy(FACTORS, _terms, allowed={"type": "object"})] | None = None

    @cached_property
    def shape(self) -> Filter | None:  # pyright: ignore[reportIncompatibleVariableOverride]
        """The filter of the row; None for a sum with a constant weight."""
        unshaped = self.filter is self.numerator is self.denominator is None
        return None if unshaped and self.sum is not None else super().shape


def check_integrals(
    entry: ControllerEntry, integrals: Mapping[str, Mapping[str, float]], heard: Mapping[str, float], sampled: bool
) -> None:
    """Checks that every integral in z has a finite norm, and that the designed law has a state for each of these integrals.

    Args:
        entry: controller to be checked.
        integrals: integrated signals in the controlled output z of the vehicle, by name of the integrator state.
        heard: rms value of the implementation's sensor noise, by signal.
        sampled: True if the controllers are designed for the sampled loop.

    Raises:
        InputError: the controller cannot be combined with an integral. The message gives the reason and an alternative.
    """
    if not entry.linear:
        return
    request, structure = entry.request, entry.request.structure
    noisy = dict(zip(entry.measured, entry.hardware.noise, strict=bool(entry.hardware.noise)))
    if request.design == "lqg":
        noisy |= {name: rms for name, rms in heard.items() if name in entry.measured}
    # The noise of a signal is integrated only if the law measures all signals of the integrated sum.
    integrated = [name for terms in integrals.values() if {*terms} <= {*entry.measured} for name in terms if noisy.get(name)]
    refused = {
        f"{SAMPLED_REFUSAL}; omit sampled": sampled or request.sampled,
        "the law measures heights above a flat datum, which cannot return the integral to zero": entry.study,
        "goals are for static gains, which contain no integral; give a design or an order instead": entry.goals is not None,
        "tolerance has an error that depends on frequency; give this error as a number, or omit the pole at 0": entry.errors,
        "the law then has an integrator, so the law alone is not stable; omit stable": request.stable,
        "a law with a structure has no state for it; give order = 2 without structure, or a design": (
            structure is not None and (structure.kind or structure.rows is not None)
        ),
        f"the law would also integrate the noise on {''.join(integrated[:1])}, so there is no finite norm; omit this noise, or "
        "give a filter without a pole at 0": integrated,
    }
    integral = f"the integral of {next(iter(integrals)).removeprefix('integral_of_')} in [performance]"
    for why, holds in refused.items():
        if holds:
            raise InputError(f"[controllers.{entry.name}] cannot be combined with {integral}: {why}")
