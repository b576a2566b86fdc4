"""Controller design for any linear plant by linear matrix inequalities (LMIs), with a proved certificate for every design.

Public names. All units are SI. Each name in the following list is imported when it is first used:

- Vehicle files: `design_controllers` designs the controllers of a vehicle file. See also `Designer` and `Controller`.
- Plants: `GeneralizedPlant` (continuous, or discrete if `dt` is given) and `Feedback` (a gain and its measurements).
- All design methods: `design_feedback` selects a design method and returns a `FeedbackDesign`.
- Static gains: `two_step_design`, `static_output_feedback` and `refine`. `multi_objective_design` solves a
  `MultiObjectiveProblem`, which consists of `NormSpecification`, `FamilyMember`, `MeasuredPlant` and `GainErrors`.
  `slack_design` is deprecated.
- Dynamic controllers and quadratic designs: `full_order_design`, `lqr_design`, `lqg_design`, `h2_design`, `preview_design`.
- Analysis of a closed loop: `certify`, `hinf_norm`, `norm_in_band`, `worst_norm`, `find_lower_bound`.
- Analysis of a sampled-data loop: `sampled_norm` computes the norm of a `SampledLoop`, for example from `SampledLoop.of_gain`.
  A `HoldInterval` describes a part of the sample period in which the forces are constant.
- Conversion to and from python-control: `from_state_space`, `controller_from`, `closed_loop`, `law_system`.
- Errors: `DesignError` and `InfeasibleError`. A design function raises an error if no controller is found.

Start reading the code at `synth/vehicle/designer.py` for vehicles, and at `synth/design/feedback.py` for any linear plant. Only
`synth/vehicle` and the packages that build on it depend on vehicle models; all other packages work for any linear plant. Names
in `synth` that are not in the list above may be moved or renamed at any time.
"""

import sys

try:
    from models.common.lazy import attach
except Exception as error:  # the user has a file or folder with the same name as a package of Roadproof
    from importlib.util import find_spec

    _spec = find_spec("models")
    _place = "nothing" if _spec is None else _spec.origin or next(iter(_spec.submodule_search_locations or ()))
    _line = f"{_place} hides Roadproof's package 'models'; rename that file or folder, or start commands as in: roadproof bump"
    if sys.argv[:1] != ["-m"]:
        raise ImportError(_line) from error
    sys.stderr.write(f"roadproof: {_line}\n")
    raise SystemExit(2) from error

TYPE_CHECKING = False
if TYPE_CHECKING:  # type checkers and editors see these imports
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
