"""Converts goals, written as in a vehicle file, to a problem for plants whose signals need not have names.

The signals of a plant without names are y1, y2, ..., its forces are u1, u2, ..., and the rows of z are z1, z2, ...
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from models.common.errors import InputError, list_names
from models.common.schema import read
from models.laws.goals import CORNER, DecayBound, EnergyBound, GainBound, Goals, NormBound, NormOf, PeakBound
from synth.design.multi_objective.objectives import BoundedSignal
from synth.design.multi_objective.problem import FamilyMember, GainErrors, MultiObjectiveProblem, NormSpecification
from synth.plant.generalized import Plant

MATRICES = "A", "B", "Bw", "C", "Cy"  # matrices that must have the same shapes in all plants of a family


def norms_of(goals: Goals) -> list[NormOf]:
    """Returns the norm that is minimised, followed by the norms that are bounded."""
    return [goals.minimise, *(bound for bound in goals.bounds if isinstance(bound, NormBound))]


def posed_goals(
    goals: Goals, members: Sequence[FamilyMember], measured: Sequence[str], forces: Sequence[str]
) -> MultiObjectiveProblem:
    """Returns the multi-objective problem for given goals, without the individual optima of its members.

    Args:
        members: members of the family, each with a plant for every entry of `norms_of`, and with the data for the other bounds.
        measured: names of the q measured signals.
        forces: names of the m inputs.
    """
    m, q = len(forces), len(measured)
    bounds = [
        NormSpecification(i + 1, bound.rates, bound.norm, f"{bound.text} <= {bound.norm:g}")
        for i, bound in enumerate(each for each in goals.bounds if isinstance(each, NormBound))
    ]
    tolerance = goals.tolerance
    errors = GainErrors(
        np.array([tolerance.get(signal, 0.0) for signal in measured]),
        np.array([goals.force_error(force) for force in forces]),
    )
    return MultiObjectiveProblem(
        tuple(members),
        NormSpecification(0, goals.minimise.rates),
        errors,
        np.ones((m, q), dtype=bool) if goals.structure is None else np.array(goals.structure),
        norms=tuple(bounds),
        decay=_strictest([bound.decay for bound in goals.bounds if isinstance(bound, DecayBound)], max),
        peaks=tuple(bound.at_most for bound in goals.bounds if isinstance(bound, PeakBound)),
        gain=_strictest([bound.gain for bound in goals.bounds if isinstance(bound, GainBound)], min),
    )


def _strictest(values: Sequence[float], of: Callable[[Sequence[float]], float]) -> float | None:
    return of(values) if values else None


def goals_of_plants(where: str, section: Mapping[str, Any], plants: Sequence[Plant]) -> tuple[Goals, MultiObjectiveProblem]:
    """Returns the goals and the multi-objective problem that the goals define, for plants with the same size and measurements.

    Args:
        where: text with which error messages begin.
        section: keys `minimise`, `bounds`, `tolerance` and `structure`, as in a vehicle file.
        plants: the nominal plant, followed by the other plants.

    Raises:
        InputError: a key or a number is not allowed, or the plants differ in size.
    """
    first = plants[0]
    for i, plant in enumerate(plants[1:]):
        if any(getattr(plant, name).shape != getattr(first, name).shape for name in MATRICES) or plant.dt != first.dt:
            has, expected = ([f"{name} {getattr(one, name).shape}" for name in MATRICES] for one in (plant, first))
            raise InputError(
                f"{where} family[{i}] has the shapes {list_names(has)}, and dt = {plant.dt}, but must have the shapes "
                f"and the dt of the plant; give {list_names(expected)}, and dt = {first.dt}"
            )
    measured, forces, outputs = (
        _names(letter, count) for letter, count in zip("yuz", (len(first.Cy), *first.D.T.shape), strict=True)
    )
    if section.get("structure") == CORNER:
        raise InputError(
            f'{where} structure = "{CORNER}" is allowed only for vehicles; give rows of 0 and 1, one row for each force'
        )
    family = {"family": [{}] * len(plants)} if len(plants) > 1 else {}
    names = {"signals": dict.fromkeys(outputs, "1"), "corners": dict.fromkeys(forces, ""), "parameters": {}}
    goals = read(where, Goals, {**section, **family}, measured=measured, **names)
    if goals.tolerance != goals.goals.tolerance:
        raise InputError(
            f"{where} a tolerance with a weight is allowed only for vehicles; give the tolerance as one number, the largest "
            "relative error (0.1 is 10 %)"
        )
    if any(isinstance(bound, PeakBound) for bound in goals.bounds):
        raise InputError(
            f"{where} bounds: a bound on a peak over a road is allowed only for vehicles; bound an energy_peak or a norm instead"
        )
    norms = norms_of(goals)
    energies = [bound for bound in goals.bounds if isinstance(bound, EnergyBound)]
    members = [
        FamilyMember(
            tuple(_with_outputs_of_norm(plant, norm, outputs) for norm in norms),
            signals=tuple(_signal(where, plant, outputs.index(bound.energy_peak), bound) for bound in energies),
        )
        for plant in plants
    ]
    return goals, posed_goals(goals, members, measured, forces)


def _names(letter: str, count: int) -> list[str]:
    return [f"{letter}{i + 1}" for i in range(count)]


def _with_outputs_of_norm(plant: Plant, norm: NormOf, outputs: Sequence[str]) -> Plant:
    """Returns the plant with the weighted signals of a norm goal as its output z."""
    if norm.signals is None:
        return plant
    rows, weights = [outputs.index(name) for name in norm.signals], np.array([*norm.signals.values()])[:, None]
    return replace(plant, C=weights * plant.C[rows], D=weights * plant.D[rows], Dw=weights * plant.Dw[rows])


def _signal(where: str, plant: Plant, row: int, bound: EnergyBound) -> BoundedSignal:
    """Returns a row of z as a signal whose magnitude is bounded for disturbances of a given energy."""
    if np.any(plant.Dw[row]) or np.any(plant.Dyw) or plant.dt is not None:
        raise InputError(
            f"{where} bounds: energy_peak of {bound.energy_peak} is infinite, because w, noise or sampling acts "
            "directly on this signal; bound the norm of the signal instead"
        )
    name = f"{bound.energy_peak} for w of energy {bound.energy:g} <= {bound.at_most:g}"
    return BoundedSignal(plant.C[row], plant.D[row], bound.at_most, bound.energy**0.5, name)
