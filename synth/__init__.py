"""Controllers: LMIs over any linear plant, and certificates. Nothing below `controller/` knows a vehicle.

Public names, imported when they are first used; all units are SI:

- of a vehicle: `design_controllers`, `Designer`, `Controller`
- any plant: `GeneralizedPlant`, continuous or with `dt`, and `Feedback`
- any plant, every type of design: `design_feedback`, which returns a `FeedbackDesign`
- static gains: `two_step_design`, `static_output_feedback`, `refine`; for a family of plants `slack_design`; for goals
  `multi_objective_design` of a `MultiObjectiveProblem` with `NormSpecification`, `FamilyMember`, `MeasuredPlant`, `GainErrors`
- controllers with states: `full_order_design`, `lqr_design`, `lqg_design`, `h2_design`, `preview_design`
- analysis of a loop: `certify`, `hinf_norm`, `norm_in_band`, `worst_norm`, `find_lower_bound`; of one that a computer closes
  `sampled_norm` of a `SampledLoop`, as of `SampledLoop.of_gain`; its period has a `HoldInterval` or two
- python-control: `from_state_space`, `controller_from`, `closed_loop`, `law_system`
- failures: `DesignError`, `InfeasibleError`; a design never returns an empty controller

All other names of a module may move without notice.
"""

import sys
from importlib.util import find_spec
from os.path import dirname, join

if sys.argv[:1] == ["-m"] and not sys.flags.safe_path and sys.path[0] != dirname(__path__[0]):
    sys.path.append(sys.path.pop(0))  # the user's folder comes last: its models.py is not ours

for _name in ("models",):
    _spec = find_spec(_name)
    _where = [] if _spec is None else [*(_spec.submodule_search_locations or ())]
    if _spec is not None and join(dirname(__path__[0]), _name) not in _where:
        _line = (
            f"{_spec.origin or _where[0]} hides Roadproof's package {_name!r}; rename it, or run commands as in: roadproof bump"
        )
        if sys.argv[:1] != ["-m"]:
            raise ImportError(_line)
        sys.stderr.write(f"roadproof: {_line}\n")
        raise SystemExit(2)

from models.common.interrupt import quiet_start

quiet_start()

from typing import TYPE_CHECKING

from models.common.lazy import attach

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
    __getattr__, __dir__, __all__ = attach(
        __name__,
        {
            "synth.analysis.band_norm": "norm_in_band",
            "synth.analysis.certificate": "certify",
            "synth.analysis.norm": "hinf_norm",
            "synth.analysis.sampled_loop": "HoldInterval SampledLoop",
            "synth.analysis.sampled_norm": "sampled_norm",
            "synth.controller.controller": "Controller",
            "synth.design.descent.refine": "refine",
            "synth.design.feedback": "FeedbackDesign design_feedback",
            "synth.design.full_order.full_order": "full_order_design",
            "synth.design.full_order.preview": "preview_design",
            "synth.design.full_order.quadratic": "h2_design lqg_design lqr_design",
            "synth.design.multi_model": "slack_design",
            "synth.design.multi_objective.design": "multi_objective_design",
            "synth.design.multi_objective.problem": (
                "FamilyMember GainErrors MeasuredPlant MultiObjectiveProblem NormSpecification"
            ),
            "synth.design.static": "static_output_feedback",
            "synth.design.two_step": "two_step_design",
            "synth.design.uncertainty.worst_case": "worst_norm",
            "synth.lmi.full_order_bound": "find_lower_bound",
            "synth.plant.generalized": "Feedback GeneralizedPlant",
            "synth.plant.numerics": "DesignError InfeasibleError",
            "synth.vehicle.designer": "Designer design_controllers",
            "synth.vehicle.state_space": "closed_loop controller_from from_state_space law_system",
        },
    )
