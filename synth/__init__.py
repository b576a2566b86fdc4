"""Controllers: LMIs over any linear plant, and certificates. Nothing below `controller/` knows a vehicle.

Public names, imported when they are first used; all units are SI:

- of a vehicle: `design_controllers`, `Designer`, `Controller`
- any plant: `GeneralizedPlant`, continuous or with `dt`, and `Feedback`
- any plant, every type of design: `design_feedback`, which returns a `FeedbackDesign`
- static gains: `two_step_design`, `static_output_feedback`, `refine`; for goals `multi_objective_design` of a
  `MultiObjectiveProblem` with `NormSpecification`, `FamilyMember`, `MeasuredPlant`, `GainErrors`; `slack_design` goes
- controllers with states: `full_order_design`, `lqr_design`, `lqg_design`, `h2_design`, `preview_design`
- analysis of a loop: `certify`, `hinf_norm`, `norm_in_band`, `worst_norm`, `find_lower_bound`; of one that a computer closes
  `sampled_norm` of a `SampledLoop`, as of `SampledLoop.of_gain`; its period has a `HoldInterval` or two
- python-control: `from_state_space`, `controller_from`, `closed_loop`, `law_system`
- failures: `DesignError`, `InfeasibleError`; a design never returns an empty controller

All other names of a module may move without notice.
"""

import sys

try:
    from models.common.lazy import attach
except Exception as error:  # a file or a folder of the user's has the name of a package of ours
    from importlib.util import find_spec

    _spec = find_spec("models")
    _place = "nothing" if _spec is None else _spec.origin or next(iter(_spec.submodule_search_locations or ()))
    _line = f"{_place} hides Roadproof's package 'models'; rename that file or folder, or start commands as in: roadproof bump"
    if sys.argv[:1] != ["-m"]:
        raise ImportError(_line) from error
    sys.stderr.write(f"roadproof: {_line}\n")
    raise SystemExit(2) from error

TYPE_CHECKING = False
if TYPE_CHECKING:  # what type checkers and editors see
    from synth.analysis.band_norm import norm_in_band
    from synth.analysis.certificate import certify
    from synth.analysis.norm import hinf_norm
    from synth.analysis.sampled_loop import HoldInterval, SampledLoop
    from synth.analysis.sampled_norm import sampled_norm
    from synth.controller.controller import Controller
    from synth.design.descent.refine import refine
    from synth.design.feedback import FeedbackDesign, design_feedback
    from synth.design.full_order.full_order import full_order_design
    from synth.design.full_order.preview import preview_design
    from synth.design.full_order.quadratic import h2_design, lqg_design, lqr_design
    from synth.design.multi_model import slack_design
    from synth.design.multi_objective.design import multi_objective_design
    from synth.design.multi_objective.problem import (
        FamilyMember,
        GainErrors,
        MeasuredPlant,
        MultiObjectiveProblem,
        NormSpecification,
    )
    from synth.design.static import static_output_feedback
    from synth.design.two_step import two_step_design
    from synth.design.uncertainty.worst_case import worst_norm
    from synth.lmi.full_order_bound import find_lower_bound
    from synth.plant.generalized import Feedback, GeneralizedPlant
    from synth.plant.numerics import DesignError, InfeasibleError
    from synth.vehicle.designer import Designer, design_controllers
    from synth.vehicle.state_space import closed_loop, controller_from, from_state_space, law_system
else:
    __getattr__, __dir__, __all__ = attach(__name__, __file__)
