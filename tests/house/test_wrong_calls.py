"""Wrong calls of everything public: each argument of each valid call is replaced by what it cannot be."""

import dataclasses
import itertools
import math
import re
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import models
import sim
import synth
from models import InputError


class Stranger:
    """An object that is nothing of ours."""


STRANGER = Stranger()
WRONG: dict[str, Any] = {
    "None": None,
    "text": "nonsense",
    "nan": math.nan,
    "-1": -1,
    "no list": [],
    "list of strangers": [STRANGER],
    "stranger": STRANGER,
    "shape": np.zeros((3, 5)),
    "nans": np.full((1, 2), math.nan),
}
LOOP = Path(__file__).parents[1] / "models" / "mr_damper_loop.csv"
TEXTS = ("", "../x", "a\0", "a" * 500)


@cache
def calls() -> dict[str, tuple[Callable[..., Any], dict[str, Any]]]:
    """Every public callable, and some methods, each with arguments that are right."""
    vehicle = models.read_vehicle("quarter_car")
    designer = synth.Designer(vehicle)
    passive, controller = designer.design("passive"), designer.design("I")
    road, array = models.Bump(height=0.02), np.array
    [driven] = sim.run(vehicle, [controller], road, duration=0.2)
    A, B, C, D, Dw = map(
        array, ([[0.0, 1.0], [-4.0, -0.1]], [[0.0], [1.0]], [[1.0, 0.0], [0.0, 0.0]], [[0.0], [0.1]], [[0.0], [0.0]])
    )
    plant = synth.GeneralizedPlant(A, B, B, C, D, Dw)
    matrices = {name: getattr(plant, name) for name in ("A", "B", "Bw", "C", "D", "Dw")}
    Cy, K, kind, model = array([[0.0, 1.0]]), array([[-2.0]]), vehicle.kind, vehicle.linear_model
    plant_problem = synth.MeasuredPlant(plant, Cy)
    member, goal, none = (
        synth.FamilyMember((plant_problem,)),
        synth.NormSpecification(band=(1.0, 3.0)),
        synth.GainErrors(np.zeros(1), np.zeros(1)),
    )
    anywhere = np.ones((1, 1), dtype=bool)
    problem = synth.MultiObjectiveProblem((member,), goal, none, anywhere, gain=5.0)
    piece = synth.HoldInterval(duration=0.01, delay_samples=0)
    loop = synth.SampledLoop(plant, (piece,), array([[0.0, -2.0]]), np.zeros((0, 2)), np.zeros((0, 1)))
    import control

    system = control.ss(matrices["A"], [[0, 0], [1, 1]], np.eye(2), 0, inputs=["w", "u"], outputs=["x", "v"])
    leaky = control.ss([[-0.5]], [[0, 1]], [[-2000]], [[11000, 0]])
    points = {"distance": np.arange(9.0), "heights": np.zeros((9, 2))}
    history = {"time": np.arange(9.0) / 10, "heights": np.zeros((9, 1)), "posts": ("road",)}
    valued = {name: getattr(vehicle, name) for name in ("kind", "parameters", "performance", "controllers", "sampled", "text")}
    fields = {part.name: getattr(model, part.name) for part in dataclasses.fields(model)}
    fields = {name: value for name, value in fields.items() if name not in ("loads", "Bl", "Dl")}
    states = ("position", "velocity")
    measured = {"plant": plant, "Cy": Cy}
    of_vehicle = {"vehicle": vehicle, "controller": controller}
    log = sim.run_log(driven, "mine")
    response: dict[str, Any] = {"time": array([0.0, 0.1]), "signals": (kind.signals[0],), "values": np.zeros((2, 1))}
    return {
        "read_vehicle": (models.read_vehicle, {"file": "quarter_car"}),
        "parse_vehicle": (models.parse_vehicle, {"text": vehicle.text, "source": "", "folder": None}),
        "Vehicle": (models.Vehicle, valued),
        "replace(vehicle)": (lambda **changed: dataclasses.replace(vehicle, **changed), valued),
        "Bump": (models.Bump, {"height": 0.1, "length": 5.0, "speed": 12.0, "track": "left"}),
        "Step": (models.Step, {"height": 0.1, "edge": 0.2, "speed": 12.0}),
        "Pothole": (models.Pothole, {"depth": 0.1, "length": 1.0, "edge": 0.1, "speed": 9.0, "track": "right"}),
        "WattsHump": (models.WattsHump, {"height": 0.1, "length": 3.0, "speed": 12.0}),
        "Flat": (models.Flat, {"speed": 12.0}),
        "SineSweep": (models.SineSweep, {"amplitude": 0.1, "lowest": 0.5, "highest": 20.0, "duration": 9.0, "speed": 12.0}),
        "Iso8608": (
            models.Iso8608,
            {"road_class": "A", "seed": 3, "speed": 9.0, "track_width": 1.0, "length": 999.0, "factor": 1.0, "iri": None},
        ),
        "Profile": (models.Profile, {**points, "speed": 10.0, "source": "mine"}),
        "Rig": (models.Rig, {**history, "source": "mine"}),
        "choose_road": (models.choose_road, {"text": "bump:height=0.1", "folder": Path()}),
        "read_measured_log": (
            models.read_measured_log,
            {"path": LOOP, "units": {"force": "N"}, "rate": 100.0, "columns": {"force": "force [N]"}},
        ),
        "Parameter": (
            models.Parameter,
            {"name": "mass", "unit": "kg", "meaning": "all", "positive": True, "varied": None, "largest": 1e3, "usual": 1.0},
        ),
        "BodyLoad": (models.BodyLoad, {"name": "heave_load", "joint": "heave"}),
        "Invariant": (models.Invariant, {"name": "z_s/z_r", "signals": ("x",), "omega": max, "magnitude": max}),
        "Variation": (models.Variation, {"name": "mass", "smallest": 0.5, "largest": 2.0}),
        "Wheel": (models.Wheel, {part.name: getattr(kind.wheels[0], part.name) for part in dataclasses.fields(models.Wheel)}),
        "Suspension": (
            models.Suspension,
            {part.name: getattr(kind.suspensions[0], part.name) for part in dataclasses.fields(models.Suspension)},
        ),
        "VehicleKind": (models.VehicleKind, {part.name: getattr(kind, part.name) for part in dataclasses.fields(kind)}),
        "LinearModel": (models.LinearModel, fields),
        "LinearLaw": (models.LinearLaw, {"A": [[-1.0]], "B": [[1.0]], "C": [[1.0]], "D": [[0.0]], "sample_period": 0.1}),
        "GeneralizedPlant": (synth.GeneralizedPlant, {**matrices, "beyond": None, "weights": 0, "dt": None}),
        "closed_loop(G)": (plant.closed_loop, {"G": array([[0.0, -2.0]])}),
        "Feedback": (synth.Feedback, {"K": K, "Cy": Cy}),
        "two_step_design": (synth.two_step_design, {**measured, "path": (), "lower_bound": None, "states": states}),
        "static_output_feedback": (
            synth.static_output_feedback,
            {**measured, "largest_gain": 100.0, "lower_bound": None, "Dyw": None},
        ),
        "design_feedback": (
            synth.design_feedback,
            {**measured, "Dyw": None, "order": "static", "design": None, "stable": False, "noise": (), "sample_period": None}
            | {"delay": 0.0, "minimise": None, "bounds": (), "tolerance": None, "family": (), "structure": None}
            | {"largest_gain": None, "lower_bound": None, "states": states},
        ),
        "refine": (synth.refine, {**measured, "K": K, "Dyw": None}),
        "slack_design": (synth.slack_design, {"plants": [plant], "Cys": [Cy], "structure": None}),
        "NormSpecification": (synth.NormSpecification, {"which": 0, "band": (1.0, 3.0), "at_most": 1.0, "name": "mine"}),
        "MeasuredPlant": (synth.MeasuredPlant, {**measured, "Dyw": None}),
        "FamilyMember": (synth.FamilyMember, {"plants": (plant_problem,), "driven_by": (), "signals": ()}),
        "GainErrors": (synth.GainErrors, {"sensors": np.zeros(1), "forces": np.zeros(1)}),
        "MultiObjectiveProblem": (
            synth.MultiObjectiveProblem,
            {"members": (member,), "minimise": goal, "tolerance": none, "structure": anywhere, "norms": (goal,), "decay": 0.1}
            | {"peaks": (), "gain": 5.0, "bests": None},
        ),
        "multi_objective_design": (
            synth.multi_objective_design,
            {"problem": problem, "starts": [K], "on_progress": print, "otherwise": tuple},
        ),
        "full_order_design": (
            synth.full_order_design,
            {**measured, "Dyw": None, "lower_bound": None, "states": states, "fastest": 100.0},
        ),
        "lqr_design": (synth.lqr_design, {"plant": plant, "states": states}),
        "preview_design": (synth.preview_design, {**measured, "preview": 0.5, "states": states, "Cy": np.eye(2)}),
        "lqg_design": (synth.lqg_design, {**measured, "noise": [0.01], "states": states}),
        "h2_design": (synth.h2_design, {**measured, "Dyw": None, "states": states}),
        "certify": (
            synth.certify,
            {
                "plant": plant,
                "G": synth.Feedback(K, Cy),
                "X": np.eye(2),
                "eta": 0.1,
                "lower_bound": None,
                "plant_without_law": None,
            },
        ),
        "hinf_norm": (synth.hinf_norm, {"system": plant}),
        "norm_in_band": (synth.norm_in_band, {"loop": plant, "low": 1.0, "high": 3.0}),
        "worst_norm": (synth.worst_norm, {**measured, "K": K, "d": 0.1, "e": 0.1, "Dyw": None, "through": None, "enough": None}),
        "find_lower_bound": (synth.find_lower_bound, {**measured, "path": (), "beyond_control": None, "Dyw": None}),
        "HoldInterval": (synth.HoldInterval, {"duration": 0.01, "delay_samples": 0}),
        "SampledLoop": (synth.SampledLoop, {part.name: getattr(loop, part.name) for part in dataclasses.fields(loop)}),
        "SampledLoop.of_gain": (synth.SampledLoop.of_gain, {**measured, "K": K, "sample_period": 0.01, "delay": 0.5}),
        "sampled_norm": (synth.sampled_norm, {"loop": loop, "near": 0.3}),
        "from_state_space": (
            synth.from_state_space,
            {"system": system, "disturbances": ["w"], "performance": {"x": 1.0}, "measured": ["v"]},
        ),
        "controller_from": (
            synth.controller_from,
            {"vehicle": vehicle, "name": "leaky", "measured": ["suspension_deflection", "sprung_velocity"], "system": leaky},
        ),
        "closed_loop": (synth.closed_loop, of_vehicle),
        "law_system": (synth.law_system, of_vehicle),
        "design_controllers": (synth.design_controllers, {"vehicle": vehicle, "names": ["passive"]}),
        "Designer": (synth.Designer, {"vehicle": vehicle, "search": True}),
        "Designer.design": (designer.design, {"name": "passive", "zero_l": False, "on_progress": print}),
        "Designer.certify": (designer.certify, {"name": "mine", "measured": controller.measured, "law": controller.law}),
        "Controller": (
            synth.Controller,
            {part.name: getattr(controller, part.name) for part in dataclasses.fields(controller)[:5]},
        ),
        "Controller.loop": (controller.loop, {"vehicle": vehicle}),
        "sample_times": (sim.sample_times, {"vehicle": vehicle, "duration": 0.1, "timestep": 1e-3}),
        "run": (sim.run, {"vehicle": vehicle, "controllers": [passive], "road": road, "duration": 0.05, "timestep": 1e-3}),
        "measure_run": (sim.measure_run, {"run": driven, "first": 0}),
        "measure_responses": (
            sim.measure_responses,
            {"vehicle": vehicle, "controllers": [controller], "amplitude": 1e-3, "timestep": 4e-3, "speed": 12.5},
        ),
        "recommend": (sim.recommend, {"vehicle": vehicle, "road": road, "goal": "ride", "within": "", "timestep": 1e-3}),
        "find_margins": (sim.find_margins, {**of_vehicle, "timestep": 1e-3, "progress": print}),
        "run_log": (sim.run_log, {"run": driven, "name": "mine"}),
        "Response": (sim.Response, response),
        "Response.run": (sim.Response(array([0.0, 0.1]), (kind.signals[0],), np.zeros((3, 2, 1))).run, {"index": 0}),
        "Response.to_control": (driven.physics.to_control, {"vehicle": vehicle}),
        "record": (
            sim.record,
            {"folder": Path("nowhere/at/all"), "stem": "mine", "runs": [log], "metadata": {}, "attachments": {}},
        ),
    }


# What is right after all: another value of the same type, or what is left out by default.
GOOD = {
    "None": "folder varied usual suspended sample_period beyond dt lower_bound Dyw structure decay gain bests noise X eta "
    "plant_without_law through enough Cy beyond_control iri motion order design minimise tolerance largest_gain people "
    "road",
    "text": "source folder text name unit meaning road_body road_displacement road_velocity tyre_deflection deflection tendon "
    "force stiffness damping ratio stem joint",
    "-1": "height depth amplitude factor index",
    "no list": "parameters suspended invariants on_demand loads path states driven_by signals sensors forces norms peaks starts "
    "names measured noise bounds family heights Bt Dw people of_parts",
}
# By what the text has, or by the parameter that a value is of.
NAMED_OTHERWISE = {
    ("parse_vehicle", "text"),
    ("choose_road", "text"),
    ("Designer.design", "name"),
    ("design_controllers", "names"),
    ("Parameter", "usual"),
    ("read_measured_log", "path"),
}


PUBLIC = {*dir(models), *dir(synth), *dir(sim)}


def mistake(name: str, argument: str, what: str) -> str:
    """Returns what is wrong with how a wrong call ends; empty for an error in a line that names the argument."""
    call, right = calls()[name]
    try:
        call(**{**right, argument: WRONG[what]})
    except InputError as error:
        if private := set(re.findall(r"\ban? ([A-Z][a-z]\w*)", str(error))) - PUBLIC:
            return f"names {private}, which cannot be imported from a package: {error}"
        named = re.search(rf"\b({argument}|{argument.replace('_', ' ').removesuffix('s')})", str(error))
        return "" if named or (name, argument) in NAMED_OTHERWISE else str(error)
    except Exception as error:  # which is what is looked for
        return repr(error)
    return "is taken"


def test_wrong_calls(monkeypatch, tmp_path):
    """Each argument of a public callable that is replaced by what it cannot be is refused in a line that names it, and public
    types alone."""
    monkeypatch.chdir(tmp_path)
    mistakes = {
        f"{name}({argument} = {what})": said
        for name, (_, right) in calls().items()
        for argument, what in itertools.product(right, WRONG)
        if argument not in GOOD.get(what, "").split() and (said := mistake(name, argument, what))
    }
    assert not mistakes


def test_numbers_of_numpy(monkeypatch, tmp_path):
    """A number may be an array of no dimension, an array may have a mask without masked values, and masked values are refused."""
    monkeypatch.chdir(tmp_path)
    for name in ("Bump", "Iso8608", "Profile", "LinearLaw", "GeneralizedPlant", "run", "Response"):
        call, right = calls()[name]
        for argument, value in right.items():
            if isinstance(value, (int, float)) and not isinstance(value, bool):
                for given in (np.array(value), np.array(value)[()]):
                    made = call(**{**right, argument: given})
                    assert type(getattr(made, argument, value)) is type(value)
            elif isinstance(value, (np.ndarray, list)) and np.size(value) and np.asarray(value).dtype.kind == "f":
                call(**{**right, argument: np.ma.array(value, mask=False)})
                mask = np.arange(np.size(value)).reshape(np.shape(value)) == 0
                for wrong in (np.ma.array(value, mask=mask), [*np.ma.array(value, mask=mask)]):
                    with pytest.raises(InputError, match=f"^{argument} has masked values; fill them"):
                        call(**{**right, argument: wrong})


def test_an_unknown_signal_is_one_line():
    """Every function of a response that takes the name of a signal lists the signals that there are."""
    one = sim.Response(np.array([0.0, 0.1]), models.read_vehicle("quarter_car").kind.signals[:2], np.zeros((2, 2)))
    for call in (one.peak, one.scale, one.rms, one.__getitem__, lambda name: one.only([name])):
        with pytest.raises(InputError, match=f"no signal 'acceleration'; give one of: {', '.join(sorted(one.names))}$"):
            call("acceleration")


@pytest.mark.parametrize(
    ("name", "argument", "wrong"),
    [
        *(("find_margins", "timestep", step) for step in (1e9, 1e-9)),
        *((name, argument, text) for name, argument in (("run_log", "name"), ("record", "stem")) for text in TEXTS),
        *((name, argument, np.array(0.2)) for name, argument in (("run", "controllers"), ("Response", "signals"))),
    ],
)
def test_wrong_values(name, argument, wrong, tmp_path, monkeypatch):
    """A value of the right type that cannot be is refused at once, in a line that names the argument."""
    monkeypatch.chdir(tmp_path)
    call, right = calls()[name]
    with pytest.raises(InputError, match=argument):
        call(**{**right, argument: wrong})
    assert not [*tmp_path.iterdir()]


def test_every_public_callable_is_in_the_table():
    """The table of calls has every public function and class but bases, errors, and what is only returned."""
    named = {name for package in (models, synth, sim) for name in package.__all__ if callable(getattr(package, name))}
    returned = {"Run", "RunMetrics", "FeedbackDesign", "Recommendation", "DesignError", "InfeasibleError", "InputError"}
    returned |= {"Road", "Driver"}
    assert named - returned <= set(calls())
