"""JSON objects that describe runs, for `--json` and for logs."""

from collections.abc import Callable
from dataclasses import asdict
from operator import attrgetter
from typing import Any

import numpy as np

from models.common.extensions import FEATURES
from models.document.field import OMITTED_KEY, Field, Record, if_any
from sim.observers.results import Energy
from sim.runs.result import RunResult
from synth.controller.controller import AnyController
from synth.controller.law_margins import law_margins
from synth.controller.report import BOUND, GROWTH, NORM, PEAK

SIZE = Field[float]("size", float, ".5g")  # peak or rms of a signal
SIZES: tuple[Field[tuple[RunResult, str]], ...] = tuple(  # fields for the peak and the rms of a signal in a run
    Field(f"{what}, {name}", lambda of, get=attrgetter(f"{source}.{what}"): float(get(of[0])(of[1])), SIZE.form, key=name.lower())
    for what in ("peak", "rms")
    for name, source in {"MuJoCo": "physics", "sampled": "sampled", "continuous": "continuous"}.items()
)


BALANCE = Record[Energy](
    lambda one: {key: value for key, value in asdict(one).items() if key not in ("least", "loads") or value is not None},
    balances=lambda one: one.balances if one.judged else None,
)  # fields of an energy balance [J]; the residual is given as a share of `turnover`


def _local_check(where: str, *names: str) -> Callable[[RunResult], dict[str, Any] | None]:
    """Returns a function that describes one of the two local checks of a run as JSON; None if the check was not made."""
    return Record(**{name: lambda one, name=name: getattr(one, name, None) for name in ("agrees", *names)}).all(where)


def _worst_line(run: RunResult) -> dict[str, Any] | None:
    """Returns, as JSON, the largest error of the linearisation at equilibrium; None if no signal is compared with the
    linearisation.
    """
    if not (errors := run.line_errors):
        return None
    worst = max(errors, key=errors.__getitem__)
    return {"error": errors[worst], "signal": worst, "over": "peak in MuJoCo"}


def _shortfall(run: RunResult) -> dict[str, Any]:
    """Returns, as JSON, the requested force that semi-active dampers did not supply; empty if there are no such dampers."""
    if not run.vehicle.dampers:
        return {}
    return {"shortfall": FEATURES.load("forces that dampers lack").shortfalls(run.vehicle, run.physics)}


def _decay(run: RunResult) -> dict[str, Any]:
    """Returns, as JSON, the modes of a free decay; empty if the vehicle starts in equilibrium."""
    if not run.vehicle.start:
        return {}
    return FEATURES.load("decay").record(run)


HALF_STEP = Record("difference", "signal")  # change of the response if a run with a lift-off is repeated at half the time step
SIGNAL = Record[tuple[RunResult, str]](
    unit=lambda of: of[0].vehicle.kind.signal(of[1]).unit,
    peak=Record(*SIZES[:3]),
    rms=Record(*SIZES[3:]),
    error=Record(
        sampled=lambda of: of[0].agreement.signals[of[1]].sampled,
        continuous=lambda of: of[0].agreement.signals[of[1]].continuous,
        linearisation=lambda of: of[0].line_errors.get(of[1], OMITTED_KEY),
    ),
)


def controller_record(controller: AnyController) -> dict[str, Any]:
    """Describes a controller as JSON. For a Python control law, the results of linear analysis are None."""
    if controller.linear is False:
        return controller.record | dict.fromkeys(("bound", "norm", "peak_frequency", "stability"))
    claims = Record(BOUND, NORM, PEAK, stability=lambda one: one.stability.verdict)
    return {**controller.record, **claims(controller.certificate), **GROWTH(controller)}


RUN = np.errstate(over="ignore")(  # squares of an unstable loop's signals overflow; None is written for infinite values
    Record[RunResult](
        Record(
            controller=lambda run: controller_record(run.controller),
            signals=SIGNAL.all(lambda run: {name: (run, name) for name in run.agreement.signals}),
            until="agreement.until",
            lift_off="agreement.lift_off",
            agrees="agreement.agrees",
            steps=_local_check("agreement.steps", "error", "allowed", "since", "until"),
            commands=_local_check("agreement.commands", "repeatable", "error", "allowed", "since"),
            cause="agreement.cause",
            reference=lambda run: run.prediction.reference if run.prediction.linearised else OMITTED_KEY,
            linearisation=lambda run: _worst_line(run) if run.prediction.linearised else OMITTED_KEY,
            stops=lambda run: FEATURES.load("stops that a run reaches").STOPS(run) if run.vehicle.limits.stopped else OMITTED_KEY,
            dampers=if_any(_shortfall),
        ),
        _decay,
        code_difference=lambda run: (
            FEATURES.load("effect of exported code").DIFFERENCES(run.agreement.code_effect)
            if run.agreement.code_effect
            else OMITTED_KEY
        ),
        margins=lambda run: law_margins(run.vehicle, run.controller).record if run.controller.linear else OMITTED_KEY,
        energy=BALANCE.all(lambda run: run.energy or OMITTED_KEY),
    )
)
