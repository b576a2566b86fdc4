"""The other ways to design a controller, by the names that a vehicle file has for them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from models.common.printed import digits
from models.laws.law_structure import LawStructure
from models.laws.linear import LinearLaw
from synth.analysis.certificate import Certificate
from synth.analysis.lower_bound import LowerBound
from synth.design.fixed_order.fixed_order import fixed_order_design
from synth.design.full_order.full_order import full_order_design
from synth.design.full_order.quadratic import AT_ONCE, quadratic_design
from synth.plant.generalized import Plant


@dataclass(frozen=True, eq=False)
class NamedDesign:
    """A controller of one of these ways.

    Attributes:
        law: law on C_y x + Dyw w.
        certificate: certificate of its loop.
        remarks: notes in words: the distance from the optimum, or the objective and the assumptions.
    """

    law: LinearLaw
    certificate: Certificate
    remarks: tuple[str, ...]


def named_design(
    name: str,
    structure: LawStructure | None,
    plant: Plant,
    lower_bound: LowerBound,
    states: Sequence[str],
    noise: Sequence[float] | None,
    stable: bool,
    as_run: Callable[[LinearLaw], LinearLaw],
    on_found: Callable[[LinearLaw], None] = lambda law: None,
    fastest_pole: float | None = None,
) -> NamedDesign:
    """Designs a controller by one of these methods.

    Args:
        name: "full", "lqr", "lqg" or "h2"; "order" with a structure.
        structure: structure of the law, for "order".
        plant: plant with measurements; for "lqr" as many as states, whose Dyw counts for "full", "order" and "h2" only.
        lower_bound: lower bound for controllers from these measurements.
        noise: noise of each measurement, for "lqg", see `lqg_design`; None without noise.
        stable: True for a law that is stable by itself, for "full" and "order".
        as_run: returns a law as it is run, see `full_order_design`.
        on_found: callback of "order", see `fixed_order_design`.
        fastest_pole: largest magnitude of the loop's poles [rad/s], for "full".

    Raises:
        InputError, InfeasibleError, DesignError: errors of `full_order_design`, `fixed_order_design` and `quadratic_design`.
    """
    if structure is not None:
        result = fixed_order_design(plant, structure, lower_bound, states, stable, as_run, on_found=on_found)
        return NamedDesign(result.law, result.certificate, result.remarks)
    if name == "full":
        full = full_order_design(
            plant, lower_bound=lower_bound, states=states, stable=stable, as_run=as_run, fastest_pole=fastest_pole
        )
        return NamedDesign(full.law, full.certificate, (full.remark,) if full.remark else ())
    quadratic = quadratic_design(name, plant, states, noise)
    # Noise in D_yw is part of w, in the scale in which that counts it; LQG's has its own intensity.
    heard = {"lqg": noise, "h2": plant.Dyw}.get(name)
    beside = {"lqg": ", with noise of the sensors", "h2": ", with noise of w on the sensors"}
    best = (
        f"minimises the mean square of z: the H2 norm is {digits(quadratic.h2_norm)}, the rms of z if road velocity is white "
        f"noise of intensity 1{beside[name] if heard is not None and np.any(heard) else ''}{AT_ONCE if np.any(plant.Dw) else ''}"
    )
    return NamedDesign(quadratic.law, quadratic.certificate, (best, *([quadratic.remark] if quadratic.remark else [])))
