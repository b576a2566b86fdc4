"""Designs for goals: as good as is known, within their bounds, each promise proved and true; what cannot be had is said."""

import itertools
import json
import re
import warnings
from dataclasses import replace

import numpy as np
import pytest
from scipy import signal as signals
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from models.common.errors import InputError
from models.figures.figure import Spans
from models.laws.goals import BOUND_KINDS
from models.laws.linear import static_law
from models.roads.road import Bump
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from synth.analysis.band_norm import norm_in_band
from synth.analysis.norm import gain_at, hinf_norm
from synth.analysis.specification import Specification
from synth.command.responses import responses_figure
from synth.command.table import Row
from synth.design.multi_objective.band_filter import band_filter
from synth.design.multi_objective.band_norm import BandLandscape
from synth.design.multi_objective.design import MultiObjectiveDesign, improved_goal, multi_objective_design
from synth.design.multi_objective.objectives import EnergyPeak, NormObjective
from synth.design.multi_objective.peak import Peak, RoadPeak, peak_over_road
from synth.design.multi_objective.problem import FamilyMember, GainErrors, MeasuredPlant, MultiObjectiveProblem, NormSpecification
from synth.design.multi_objective.road_response import RoadExcitation, RoadLoop
from synth.design.multi_objective.search import GLANCE, TURNS_ON, MinimaxSearch
from synth.plant.generalized import GeneralizedPlant
from synth.plant.numerics import DesignError
from synth.vehicle.designer import Designer, certify_given
from synth.vehicle.multi_objective import goal_problem, run_search
from tests import shared
from tests.analysed import continuous_response
from tests.benchmarks.states import chain
from tests.commands import attacks, main_of, refused

HZ = 2 * np.pi
THREE = '["suspension_deflection", "sprung_velocity", "unsprung_velocity"]'
TWO, ONE = '["suspension_deflection", "sprung_velocity"]', '["sprung_velocity"]'
BAND = "minimise = { band = [4.0, 8.0] }"
KEPT = "{ norm = 8.63 }, { decay = 1.19 }"
SIX = ", ".join(
    f"{{ sprung_mass = {mass}, tyre_stiffness = {tyre} }}" for mass, tyre in itertools.product((0.7, 1.0, 1.4), (0.75, 1.25))
)
TWO_OF_SIX = "{ sprung_mass = 0.7, tyre_stiffness = 1.25 }, { sprung_mass = 1.4, tyre_stiffness = 0.75 }"
CORNERS = ("front", "rear")
FOUR = ("front_left", "front_right", "rear_left", "rear_right")


def vehicle_with(section: str, name: str = "quarter_car"):
    """A shipped vehicle whose only controller is `goal`."""
    text = re.sub(r"(?ms)^\[controllers\..*", "", read_vehicle(name).text)
    return parse_vehicle(f"{text}\n[controllers.goal]\n{section}\n")


def designed(section: str, name: str = "quarter_car"):
    """The controller, and what is known of its promises by their names: what is proved, or the value where that is exact."""
    controller = shared.designed(vehicle_with(section, name), "goal")
    assert controller.certificate.failures == ()
    assert controller.unmet_specifications == ()
    return controller, {each.what: each.value if each.proved is None else each.proved for each in controller.specifications}


@pytest.mark.parametrize(("measured", "best"), [(TWO, 2.034), *attacks([(THREE, 0.782)])])
def test_a_band(measured, best):
    """From 4 to 8 Hz, the norm bounded and the poles held left: as good as is known, all three proved."""
    controller, promises = designed(f"measured = {measured}\n{BAND}\nbounds = [{KEPT}]")
    assert promises["norm from 4 to 8 Hz"] <= best
    assert controller.certificate.norm.value <= 8.63
    assert max(pole.real for pole in controller.certificate.poles) <= -1.19


@pytest.mark.attack
def test_a_travel_limit_costs_comfort_and_is_kept(paper):
    """With 97 mm of travel over the paper's bump the band costs less than 0.915, and the bump's own response keeps 97 mm."""
    bound = '{ peak = "suspension_deflection", road = "bump", at_most = 0.097 }'
    controller, promises = designed(f"measured = {THREE}\n{BAND}\nbounds = [{KEPT}, {bound}]")
    assert promises["norm from 4 to 8 Hz"] <= 0.915
    time = np.linspace(0.0, 4.0, 8001)
    response = continuous_response(paper, controller, Bump(), time)
    reached = np.abs(response["suspension_deflection"]).max()
    promised = promises["largest suspension_deflection over bump"]
    assert reached <= promised <= 0.097
    assert promised == pytest.approx(reached, rel=1e-5)  # another solver, whose times are 0.5 ms apart


@pytest.mark.parametrize(("measured", "best"), attacks([(TWO, 7.871), (ONE, 7.866)]))
def test_a_tolerance(measured, best):
    """Sensors off by 20 %: the worst norm over the whole box is proved to be what is asked, and no sample of it exceeds that."""
    names = json.loads(measured)
    tolerance = ", ".join(f"{name} = 0.2" for name in names)
    controller, promises = designed(f"measured = {measured}\ntolerance = {{ {tolerance} }}")
    proved = promises["norm, with errors"]
    assert proved <= best
    plant, rng = Designer(vehicle_with(f"measured = {measured}")).problem(names).plant, np.random.default_rng(20261122)
    Cy = Designer(vehicle_with(f"measured = {measured}")).problem(names).Cy
    norms = [
        hinf_norm(plant.closed_loop(controller.gain * (1 + rng.uniform(-0.2, 0.2, len(names))) @ Cy)).value for _ in range(100)
    ]
    found = next(promise.value for promise in controller.specifications if "errors" in promise.what)
    assert max(norms) <= found * (1 + 1e-9) <= proved


@pytest.mark.attack
@pytest.mark.parametrize(
    ("measured", "family", "count", "worst", "regret"),
    [
        (TWO, SIX, 6, 12.533, 1.0024),
        (ONE, SIX, 6, 12.517, 1.0207),
        (ONE, TWO_OF_SIX, 2, 12.516, 1.0077),
    ],
)
def test_a_family(measured, family, count, worst, regret):
    """For some vehicles the worst norm is as asked, and the largest ratio to a vehicle's own best better than what was known."""
    _, promises = designed(f"measured = {measured}\nfamily = [{family}]")
    assert promises[f"largest norm of {count} vehicles"] <= worst
    _, promises = designed(f'measured = {measured}\nminimise = {{ over = "regret" }}\nfamily = [{family}]')
    assert promises["largest ratio to a vehicle's own best"] < regret


def test_a_family_from_a_file(tmp_path):
    """A table of factors, or TOML, stands for the list that it holds, in the text that logs and saved files carry, too."""
    rows = [(0.7, 0.75), (1.0, 1.25)]
    (tmp_path / "fleet.csv").write_text("sprung_mass,tyre_stiffness\n" + "".join(f"{a},{b}\n" for a, b in rows))
    listed = ", ".join(f"{{ sprung_mass = {a}, tyre_stiffness = {b} }}" for a, b in rows)
    (tmp_path / "fleet.toml").write_text(f"family = [{listed}]")
    for name, end in (("old_mac.csv", b"\r"), ("windows.csv", b"\r\n")):
        (tmp_path / name).write_bytes((tmp_path / "fleet.csv").read_bytes().replace(b"\n", end))
    path = tmp_path / "car.toml"
    for name in ("fleet.csv", "fleet.toml", "old_mac.csv", "windows.csv"):
        text = vehicle_with(f"measured = {TWO}").text + f'family = "{name}"\n'
        path.write_text(text)
        vehicle = read_vehicle(path)
        goals = parse_vehicle(vehicle.text).controllers["goal"].goals
        assert goals is not None
        assert [dict(member) for member in goals.family] == [{"sprung_mass": a, "tyre_stiffness": b} for a, b in rows]
        assert tmp_path / name in vehicle.files


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("sprung_mass\n", "no line of numbers; give a .toml file"),
        ("sprung_mass\n1,2\n", "no line above line 2 names its 2 column(s); give"),
        ("sprung_mass\n1\nheavy\n", "line 3, column 1: 'heavy' is no finite number"),
        ("sprung_mass\nnan\n", "line 2, column 1: 'nan' is no finite number"),
        ("colour\n1.0\n", "has no parameter 'colour'"),
        ("sprung_mass\n" + "1" * 140_000, "is no finite number; give a .toml file"),
        ("sprung_mass,tyre_stiffness, sprung_mass\n1,1,2\n", "line 1: two columns are called 'sprung_mass'; leave one out"),
    ],
)
def test_a_wrong_file_of_a_family(tmp_path, content, said):
    """One line that names the controller, and what of the file is wrong."""
    (tmp_path / "fleet.csv").write_text(content)
    (tmp_path / "car.toml").write_text(vehicle_with(f"measured = {TWO}").text + 'family = "fleet.csv"\n')
    with pytest.raises(InputError) as error:
        read_vehicle(tmp_path / "car.toml")
    assert said in str(error.value)
    assert "[controllers.goal]" in str(error.value)


@pytest.mark.attack
def test_per_corner():
    """The half-car's gain of two corners apart, of at most 3e4, is better than what was known, and zero where it has to be."""
    measured = json.dumps([f"{name}_{corner}" for name in ("suspension_deflection", "sprung_velocity") for corner in CORNERS])
    controller, promises = designed(f'measured = {measured}\nstructure = "corner"\nbounds = [{{ gain = 3e4 }}]', "half_car")
    assert promises["norm"] <= 5.966
    assert np.abs(controller.gain).max() <= 3e4
    assert np.array_equal(controller.gain != 0, [[1, 0, 1, 0], [0, 1, 0, 1]])


@pytest.mark.attack
def test_what_cannot_be_had_is_named():
    """Bounds that exclude each other are both named, with how far they are passed where both are passed alike."""
    bounds = '{ norm = 7.5 }, { peak = "suspension_deflection", at_most = 0.05 }, { decay = 1.19 }'
    with pytest.raises(DesignError) as error:
        Designer(vehicle_with(f"measured = {ONE}\n{BAND}\nbounds = [{bounds}]")).design("goal")
    said = str(error.value)
    norm, travel = (re.search(rf"{each} is passed by ([\d.]+) %", said) for each in ("norm <= 7.5", "over bump <= 0.05"))
    assert norm is not None
    assert travel is not None
    assert abs(float(norm[1]) - float(travel[1])) <= 2  # a minimum of the largest excess, as it is printed


def test_a_given_gain_is_judged_by_its_goals(tmp_path, capsys):
    """The printed controller I, with a tolerance of 22 %, is unstable within it; the command says so and exits 1."""
    path = tmp_path / "car.toml"
    section = f"measured = {TWO}\ngain = [[10824.0, -2071.0]]\ntolerance = {{ suspension_deflection = 0.22 }}\n"
    path.write_text(vehicle_with(section).text)
    assert main_of("synth")(["--vehicle", str(path), "--controller", "goal", "--json"]) == 1
    row = json.loads(capsys.readouterr().out)["controllers"][0]
    worst = next(promise for promise in row["promises"] if "errors" in promise["promise"])
    assert worst["value"] is None
    assert not worst["holds"]
    assert any("with errors" in failure for failure in row["failures"])


def test_saved_goals_are_checked_again(tmp_path, capsys):
    """A design with its goals is saved with them, and checked by them; a bound made stricter than the gain keeps fails."""
    bound = '{ peak = "suspension_deflection", road = "bump:height=0.08", speed = 10.0, at_most = 0.09 }'
    section = f"measured = {ONE}\n{BAND}\nbounds = [{{ norm = 9.63 }}, {bound}]\n"
    path, saved = tmp_path / "car.toml", tmp_path / "saved.toml"
    path.write_text(vehicle_with(section).text)
    assert main_of("synth")(["--vehicle", str(path), "--controller", "goal", "--save", str(saved), "-v"]) == 0
    assert main_of("synth")(["--check", str(saved)]) == 0
    assert "promise: norm from 4 to 8 Hz" in capsys.readouterr().out
    saved.write_text(saved.read_text().replace('"norm" = 9.63', '"norm" = 7.8').replace("norm = 9.63", "norm = 7.8"))
    assert main_of("synth")(["--check", str(saved)]) == 1
    assert "not kept: norm" in " ".join(capsys.readouterr().out.split())


@pytest.mark.parametrize(
    ("section", "said"),
    [
        ("minimise = 3", "minimise = 3 is not a table"),
        ("minimise = { band = [8.0, 4.0] }", "band = [8.0, 4.0] is not allowed"),
        ("minimise = { band = [4.0, nan] }", "is not allowed; give two frequencies"),
        ("minimise = { band = [4.0, inf] }", "minimise band = [4.0, inf] is not allowed; give two frequencies"),
        ("minimise = { band = [4.0, 1e308] }", "of at most 1e+06"),
        ('minimise = { signals = "speed" }', "unknown signal 'speed'"),
        ("minimise = { signals = {} }", "is not allowed"),
        ('minimise = { over = "mean" }', "over = 'mean'"),
        ('minimise = { over = "regret" }', "which is of a family"),
        ("minimise = { frequency = 3 }", "unknown key 'frequency'"),
        ("bounds = { norm = 3 }", "is no list of tables"),
        ("bounds = [{ norm = -1 }]", "norm = -1 is not allowed"),
        ("bounds = [{ norm = 8.0, decay = 1.0 }]", "is no bound"),
        ("bounds = [{ peak = 'suspension_deflection' }]", "has no at_most"),
        ("bounds = [{ peak = 'suspension_deflection', road = 'iso8608:class=C', at_most = 0.1 }]", "has no end"),
        ("bounds = [{ peak = 'suspension_deflection', road = 'mountain', at_most = 0.1 }]", "mountain"),
        ("bounds = [{ energy_peak = 'suspension_deflection' }]", "has no at_most"),
        ("bounds = [{ energy_peak = 'suspension_deflection', energy = -1, at_most = 1 }]", "energy = -1 is not allowed"),
        ("tolerance = { tyre_deflection = 0.1 }", "force is all forces"),
        ("tolerance = { sprung_velocity = 1.5 }", "is not allowed"),
        ("tolerance = { force = 0.1, control_force = 0.1 }", "give one or the other"),
        ("family = []", "is no list of vehicles"),
        ("family = [{}, 3]", "is no list of vehicles"),
        ("family = [{ sprung_mass = 0 }]", "is not allowed"),
        ("family = [{ colour = 2 }]", "has no parameter 'colour'"),
        ("structure = 'wheel'", "is not allowed; give"),
        ("structure = [[0, 0]]", "leaves no entry"),
        ("structure = [[1, 2]]", "is not allowed"),
        ('minimise = {}\norder = "full"', 'order = "full" with minimise: goals are of static gains'),
    ],
)
def test_wrong_goals_are_refused_in_one_line(section, said):
    """A wrong goal is quoted, and what is allowed is said."""
    with refused(said):
        Designer(vehicle_with(f"measured = {TWO}\n{section}")).design("goal")


def test_what_is_no_bound_is_offered_every_kind():
    """An unknown bound is answered by one of each kind, and each of those is read."""
    with pytest.raises(InputError) as error:
        vehicle_with(f"measured = {TWO}\nbounds = [{{ foo = 1 }}]")
    offered = re.findall(r"\{ (?!foo)[^}]*\}", str(error.value).partition("give one of")[2])
    assert [text.split()[1] for text in offered] == list(BOUND_KINDS)
    bounds = ", ".join(offered).replace("SIGNAL", '"suspension_deflection"').replace("ROAD", '"bump"')
    goals = vehicle_with(f"measured = {TWO}\nbounds = [{bounds}]").controllers["goal"].goals
    assert goals is not None
    assert len(goals.bounds) == len(BOUND_KINDS)


@pytest.mark.parametrize(
    ("bound", "said"),
    [
        ('peak = "suspension_deflection", road = "mountain"', "bounds[1] road = 'mountain': unknown road"),
        ('peak = "suspension_deflection", road = "absent.csv"', "bounds[1] road = 'absent.csv': road file absent.csv: "),
        ('peak = "suspension_deflection", road = "iso8608:class=C"', "bounds[1] road = 'iso8608:class=C' has no end"),
    ],
)
def test_a_bound_that_cannot_be_is_named_with_its_file(bound, said, tmp_path):
    """A mistake that shows where a bound is posed, not read, names the vehicle file and the bound, of designs and gains alike."""
    path = tmp_path / "car.toml"
    for gain in ("", "gain = [[1e4, -2e3]]"):
        goal = f"measured = {TWO}\n{gain}\nbounds = [{{ decay = 0.1 }}, {{ {bound}, at_most = 0.1 }}]"
        path.write_text(vehicle_with(goal).text)
        with pytest.raises(InputError) as error:
            Designer(read_vehicle(path)).design("goal")
        assert str(error.value).startswith(f"vehicle file {path}: [controllers.goal] {said}")


def test_a_corner_needs_signals_of_its_own():
    """The heave velocity is of no corner."""
    section = 'measured = ["suspension_deflection_front", "heave_velocity"]\nstructure = "corner"'
    with pytest.raises(InputError, match="'heave_velocity' is of no corner"):
        vehicle_with(section, "half_car")


def random_loop(rng) -> tuple[GeneralizedPlant, np.ndarray]:
    """A stable plant of some states with lightly damped modes, and what is measured."""
    n = int(rng.integers(2, 7))
    A = rng.standard_normal((n, n)) * 10 ** rng.uniform(-1, 2)
    A -= (np.linalg.eigvals(A).real.max() + 10 ** rng.uniform(-2, 1)) * np.eye(n)
    draw = rng.standard_normal
    return GeneralizedPlant(A, draw((n, 2)), draw((n, 2)), draw((3, n)), draw((3, 2)), draw((3, 2))), draw((2, n))


def test_the_landscape_in_a_band_is_the_norm_there():
    """At random gains of random plants its height is `norm_in_band`, and its slope that of differences."""
    rng = np.random.default_rng(20261122)
    for _ in range(30):
        plant, Cy = random_loop(rng)
        rates = np.sort(np.abs(np.linalg.eigvals(plant.A)))
        low, high = rates[0] * rng.uniform(0, 1), rates[-1] * rng.uniform(1, 3)
        landscape = BandLandscape(plant, Cy, None, (low, high))
        x = 0.02 * rng.standard_normal(landscape.scale.size)
        height, at = landscape.norm(x)
        if not np.isfinite(height):
            continue
        loop = plant.closed_loop(landscape.gain(x) @ Cy)
        assert height == pytest.approx(norm_in_band(loop, low, high).value, rel=1e-7)
        slope, step = landscape.slope(x, at), 1e-6 * np.eye(len(x))
        differences = [(landscape.norm(x + e)[0] - landscape.norm(x - e)[0]) / 2e-6 for e in step]
        assert slope == pytest.approx(differences, rel=1e-3, abs=1e-3 * np.abs(slope).max())  # peaks may be close to another


def test_a_peak_at_an_end_of_a_band_stays_there():
    """Where the gain is highest at an end of a band, the second derivative of the norm is that of the gain there."""
    rng = np.random.default_rng(0)
    plant, Cy = random_loop(rng)
    x, step = 0.02 * rng.standard_normal(4), 1e-3 * np.eye(4)
    _, peak = BandLandscape(plant, Cy, None, (0.0, np.inf)).norm(x)
    for band, end in (((1.2 * peak, 10 * peak), 0), ((0.1 * peak, peak / 1.2), 1)):
        landscape = BandLandscape(plant, Cy, None, band)
        height, at = landscape.norm(x)
        assert at == band[end]
        objective, weight = NormObjective(landscape, 2.0), 1e-6  # in halves of a unit; curvatures add up, however small a share
        support = objective.support(x, height / 2.0, 1e-9)
        curvature = objective.curvature(x, support, np.full(len(support.values), weight))
        differences = [weight * (landscape.slope(x + e, at) - landscape.slope(x - e, at)) / 2.0 / 2e-3 for e in step]
        np.testing.assert_allclose(curvature, differences, atol=1e-4 * np.abs(differences).max())  # of the steps, squared


def bounded(bound: str):
    """The problem of gains on three measurements with one bound, and its landscape."""
    vehicle = vehicle_with(f"measured = {THREE}\nbounds = [{{ {bound} }}]")
    entry = vehicle.controllers["goal"]
    assert entry.goals is not None
    problem = goal_problem(vehicle, entry, entry.goals)
    return problem, problem.nominal()


def test_the_slope_of_a_peak_over_a_road():
    """The slope of the largest travel in the gain agrees with differences of the response itself."""
    problem, landscape = bounded("peak = 'suspension_deflection', at_most = 0.1")
    term = RoadPeak(problem.members[0].driven_by[0], landscape.scale, 0.1)
    x = landscape.point(np.array([[10000.0, -900.0, -200.0]]))
    support = term.support(x, term.value(x), 0.01)
    slope = support.slopes[support.values.argmax()]
    differences = [(term.value(x + e) - term.value(x - e)) / 2e-5 for e in 1e-5 * np.eye(3)]
    assert slope == pytest.approx(differences, rel=1e-3)  # the integral's step is a tenth of a radian
    assert term.value(x) == pytest.approx(10 * peak_over_road(term.driven, landscape.gain(x)).value, rel=1e-5)


STIFF = np.array([[0.0, 1.0, 0.0], [-0.25, -0.2, 0.0], [0.0, 0.0, -100.0]])  # so steps are small, and the peak is late
TWICE = np.array([[0.0, 1.0, 0.0], [-1.0, -2.0, 0.0], [0.0, 0.0, -3.0]])  # a double pole, with one eigenvector


def after_a_ramp(A: np.ndarray, c: list[float], until: float) -> tuple[Peak, float, float]:
    """The peak over a ramp of half a second; by matrix exponentials the largest height up to a time, and that at the peak's.

    Under the second wheel the ramp goes half as far down.
    """
    end, Bw, Br = 0.5, np.array([[0.2, 0.0], [-0.1, 0.2], [1.0, -0.4]]), np.array([[0.0, 0.1], [1.0, -0.2], [-0.5, 0.3]])
    f, wheels = np.array([-0.1, 0.2]), np.array([1.0, -0.5])
    drive = RoadExcitation(
        heights=lambda t: np.clip(t / end, 0, 1)[:, None] * wheels,
        rates=lambda t: np.where((t > 0) & (t < end), 1 / end, 0.0)[:, None] * wheels,
        kinks=np.array([0.0, end]),
        end=end,
    )
    none, of_u = np.zeros((3, 1)), np.zeros((1, 1))
    driven = RoadLoop(A, none, none.T, of_u, Bw, Br, np.array(c), np.zeros(1), f, drive)
    peak = peak_over_road(driven, of_u)
    # Of z' and z of the first wheel, which are linear on the ramp and after it.
    system = signals.StateSpace(A, np.column_stack([Bw @ wheels, Br @ wheels]), c, [[0.0, f @ wheels]])
    ramp, after = np.linspace(0, end, 2001), np.linspace(0, until, 12001)
    _, y, x = signals.lsim(system, np.column_stack([np.full(2001, 1 / end), ramp / end]), ramp)
    _, later, _ = signals.lsim(system, np.column_stack([np.zeros(12001), np.ones(12001)]), after, X0=x[-1])
    heights = np.abs([*y, *later[1:]])
    return peak, heights.max(), np.interp(peak.time, [*ramp, *(end + after[1:])], heights)


@pytest.mark.parametrize(("A", "c", "late"), [(STIFF, [1.0, 0.0, 0.1], True), (TWICE, [0.3, -1.0, 0.5], False)])
def test_a_peak_beside_the_exact_response_to_a_ramp(A, c, late):
    """The peak over a ramp is that of matrix exponentials, of a double pole, and long after the road's end, and is proved."""
    peak, highest, then = after_a_ramp(A, c, 12.0)
    assert [peak.value, then] == pytest.approx([highest] * 2, rel=1e-5)  # a thousandth of a second
    assert (peak.time > 5.0) == late
    assert highest <= peak.proved <= highest * 1.01


def test_a_peak_after_all_steps_is_bounded():
    """Where steps end long before a slow motion has its peak, what is proved is still above it, and not far."""
    A = np.array([[0.0, 1.0, 0.0], [-4e-4, -4e-3, 0.0], [0.0, 0.0, -100.0]])
    peak, highest, _ = after_a_ramp(A, [1.0, 0.0, 0.0], 200.0)
    assert peak.time < 50.0
    assert peak.value < 0.5 * highest
    assert highest <= peak.proved <= 2 * highest


def test_the_filter_of_a_band_is_at_least_one_there():
    """So a norm weighted by it bounds the norm in the band, and from above by little: 0.5 %."""
    for low, high in ((4 * HZ, 8 * HZ), (0.0, 8 * HZ), (4 * HZ, np.inf), (0.1, 300.0)):
        system = band_filter((low, high))
        omega = np.linspace(max(low, 1e-3), min(high, 1e3), 2000)
        gains = [
            abs((system.C @ np.linalg.solve(1j * w * np.eye(len(system.A)) - system.A, system.B) + system.D)[0, 0]) for w in omega
        ]
        assert min(gains) >= 1 - 1e-9
        assert max(gains) <= 1.005


def test_a_design_for_goals_is_not_refined(tmp_path, capsys):
    """`--refine` would leave its goals: it is neither advised nor done; nor is there an L to be zero."""
    path = tmp_path / "car.toml"
    path.write_text(vehicle_with(f"measured = {TWO}\nbounds = [{{ gain = 1e4 }}]").text)
    assert main_of("synth")(["--vehicle", str(path), "--controller", "goal", "-v"]) == 0
    assert "--refine" not in capsys.readouterr().out
    with pytest.raises(DesignError, match="goals with --refine: it is static gains of the least norm that are refined"):
        Designer(read_vehicle(path)).refine("goal")
    with pytest.raises(InputError, match="no L"):
        Designer(read_vehicle(path)).design("goal", zero_l=True)


def test_goals_leave_plain_designs_alone(paper):
    """A section whose goals say nothing more than the least norm is no worse than the two steps."""
    controller, promises = designed(f"measured = {TWO}\nminimise = {{}}")
    plain = Designer(paper).design("I")
    assert promises["norm"] <= plain.certificate.norm.value
    again = certify_given(paper, "again", controller.measured, static_law(controller.gain))
    assert again.certificate.norm.value == controller.certificate.norm.value


def test_what_a_structure_costs_at_least_takes_so_many_rounds(paper):
    """A whole gain is better than one without the deflection, by what descent in a limited number of rounds finds.

    Designed by itself the whole gain is as good or better, here by less than a hundredth.
    """
    controller, promises = designed(f"measured = {TWO}\nstructure = [[0, 1]]\nbounds = [{{ gain = 1.2e4 }}]")
    price = next(remark for remark in controller.remarks if "structure costs at least" in remark)
    said, whole = (float(one) for one in re.findall(r"[\d.]+(?= %)|(?<=comes to )[\d.]+", price))
    assert said == pytest.approx(100 * (promises["norm"] / whole - 1), rel=0.06)  # two digits
    _, of_whole = designed(f"measured = {TWO}\nbounds = [{{ gain = 1.2e4 }}]")
    assert of_whole["norm"] * (1 - 1e-6) <= whole <= 1.01 * of_whole["norm"]
    vehicle = vehicle_with(f"measured = {TWO}\nbounds = [{{ gain = 1.2e4 }}]")
    entry = vehicle.controllers["goal"]
    assert entry.goals is not None
    problem = goal_problem(vehicle, entry, entry.goals)
    begun, heard = MultiObjectiveDesign(controller.gain, promises["norm"], None, (), problem), []
    assert improved_goal(problem, begun, lambda goal, within: heard.append(goal)) == pytest.approx(whole, rel=1e-6)  # 7 digits
    assert 0 < len(heard) <= GLANCE * TURNS_ON


@pytest.mark.attack
def test_a_structure_has_its_price():
    """The half-car's whole gain is designed, too, from the structured one: never worse, and what it saves is said in per cent."""
    measured = json.dumps([f"{name}_{corner}" for name in ("suspension_deflection", "sprung_velocity") for corner in CORNERS])
    controller, promises = designed(f'measured = {measured}\nstructure = "corner"\nbounds = [{{ gain = 3e4 }}]', "half_car")
    price = next(remark for remark in controller.remarks if "structure costs" in remark)
    said, whole = re.findall(r"[\d.]+(?= %)|(?<=comes to )[\d.]+", price)
    whole_gain, of_whole = designed(f"measured = {measured}\nbounds = [{{ gain = 3e4 }}]", "half_car")
    assert float(said) == pytest.approx(100 * (promises["norm"] / float(whole) - 1), abs=0.06)  # two digits
    assert float(whole) == pytest.approx(of_whole["norm"], rel=0.01)  # from another start
    assert np.abs(whole_gain.gain).max() <= 3e4


@pytest.mark.attack
def test_the_full_car_per_corner():
    """Four computers, each with its own wheel's signals: better than the two steps of the whole gain, within 7 % of the best."""
    measured = json.dumps([f"{name}_{corner}" for name in ("suspension_deflection", "sprung_velocity") for corner in FOUR])
    controller, promises = designed(f'measured = {measured}\nstructure = "corner"', "full_car")
    assert promises["norm"] <= 3.86
    assert np.count_nonzero(controller.gain) == 8
    price = next(remark for remark in controller.remarks if "structure costs" in remark)
    assert 0 < float(re.findall(r"[\d.]+(?= %)", price)[0]) < 7


@pytest.mark.attack
def test_roads_of_given_energy(paper):
    """Travel and force are bounded for every road of 0.01 m2/s: by a road that runs backwards along the impulse response, too."""
    bounds = (
        '{ energy_peak = "suspension_deflection", energy = 0.01, at_most = 0.06 }, '
        '{ energy_peak = "control_force", energy = 0.01, at_most = 600.0 }'
    )
    controller, promises = designed(f"measured = {TWO}\nbounds = [{bounds}]")
    assert promises["largest control_force for roads of 0.01 m2/s"] <= 600
    loop, model = controller.loop(paper), paper.linear_model
    row = model.rows(["suspension_deflection"])[0][0]
    t = np.linspace(0.0, 12.0, 24001)
    impulse = np.array([row @ x for x in _decaying(loop.A, loop.Bw[:, 0], t)])
    reached = 0.1 * np.sqrt(np.trapezoid(impulse**2, t))  # of the worst road of that energy: the root of its integral
    assert reached == pytest.approx(promises["largest suspension_deflection for roads of 0.01 m2/s"], rel=1e-4)  # the step's


def _decaying(A, x, t):
    """exp(A t) x at equidistant times."""
    step, found = expm(A * (t[1] - t[0])), [x]
    for _ in t[1:]:
        found.append(step @ found[-1])
    return found


def test_the_slope_of_an_energy_peak():
    """The slope in the gain agrees with differences, for a signal with the force in it."""
    problem, landscape = bounded("energy_peak = 'control_force', at_most = 1.0")
    term = EnergyPeak(landscape, problem.members[0].signals[0], 1e4)
    x = landscape.point(np.array([[10000.0, -900.0, -200.0]]))
    slope = term.support(x, term.value(x), 0.01).slopes[0]
    differences = [(term.value(x + e) - term.value(x - e)) / 2e-6 for e in 1e-6 * np.eye(3)]
    assert slope == pytest.approx(differences, rel=1e-6)


def test_what_lies_beside_a_band_is_said():
    """Without a bound on the whole norm its size is named, and how to bound it."""
    controller, _ = designed(f"measured = {TWO}\n{BAND}\nbounds = [{{ gain = 2e4 }}]")
    assert any(f"the norm is {controller.certificate.norm.value:.7g}; give bounds" in remark for remark in controller.remarks)


@pytest.mark.attack
def test_a_discrete_plant_has_goals_too():
    """In a band its goal is the band's norm of the discrete loop, and never more than without control; no decay in rad/s."""
    rng = np.random.default_rng(20261122)
    A = rng.standard_normal((4, 4))
    A *= 0.95 / np.abs(np.linalg.eigvals(A)).max()
    draw = rng.standard_normal
    plant = GeneralizedPlant(A, draw((4, 1)), draw((4, 1)), draw((2, 4)), np.array([[0.0], [0.1]]), np.zeros((2, 1)), dt=0.1)
    posed = MeasuredPlant(plant, draw((2, 4)))
    everywhere = NormSpecification(at_most=2 * hinf_norm(plant).value)
    problem = MultiObjectiveProblem(
        (FamilyMember((posed, posed)),),
        NormSpecification(band=(2.0, 12.0)),
        GainErrors(np.zeros(2), np.zeros(1)),
        np.ones((1, 2), dtype=bool),
        (replace(everywhere, which=1),),
    )
    design = multi_objective_design(problem, [np.zeros((1, 2))])
    reached = norm_in_band(plant.closed_loop(design.gain @ posed.Cy), 2.0, 12.0).value
    assert design.goal == pytest.approx(reached, rel=1e-7)
    assert reached <= norm_in_band(plant, 2.0, 12.0).value
    with pytest.raises(InputError, match="no decay"):
        multi_objective_design(replace(problem, decay=1.0), [])


DRIVEN = {
    "watts_hump:height=0.1:length=0.2": 8.0,  # upright at both ends
    "step:height=0.05:edge=0.001": 12.5,  # over within 80 us
    "pothole:edge=0.05": 15.0,
    "bump": 12.5,
}
SIGNALS = ("control_force", "tyre_deflection", "suspension_deflection")
IN_THE_SUITE = {*zip(DRIVEN, ("control_force", "tyre_deflection"), strict=False)}


@pytest.mark.parametrize(
    ("road", "speed", "signal"),
    [
        pytest.param(road, speed, signal, marks=() if (road, signal) in IN_THE_SUITE else pytest.mark.attack)
        for road, speed in DRIVEN.items()
        for signal in SIGNALS
    ],
)
def test_no_peak_lies_above_what_is_proved(road, speed, signal):
    """An adaptive integration of the loop, driven by the road's height, reaches the value, and nowhere exceeds what is proved."""
    bound = f"{{ peak = '{signal}', road = '{road}', speed = {speed}, at_most = 1e9 }}"
    vehicle = vehicle_with(f"measured = {TWO}\nbounds = [{bound}]")
    entry = vehicle.controllers["goal"]
    assert entry.goals is not None
    driven = goal_problem(vehicle, entry, entry.goals).members[0].driven_by[0]
    K = np.array([[10824.0, -2071.0]])
    peak, (A, c) = peak_over_road(driven, K), driven.loop(K)
    E, highest, x = A @ driven.Bw + driven.Br, 0.0, np.zeros(4)
    edges = [0.0, *driven.drive.kinks, driven.drive.end + 2.0]
    for start, end in itertools.pairwise(np.unique(edges)):
        found = solve_ivp(
            lambda t, x: A @ x + E @ driven.drive.heights(np.array([t]))[0],
            (start, end),
            x,
            method="DOP853",
            rtol=1e-10,
            atol=1e-13,
            dense_output=True,
            max_step=(end - start) / 50,
        )
        t = np.linspace(start, end, 20001)
        y = found.sol(t).T @ c + driven.drive.heights(t) @ (c @ driven.Bw + driven.f)
        highest, x = max(highest, np.abs(y).max()), found.y[:, -1]
    assert highest <= peak.proved
    assert peak.value == pytest.approx(highest, rel=2e-5)  # what a slope without end leaves of the integration's digits


@pytest.mark.attack
def test_a_peak_alone_leaves_no_loop_on_the_border():
    """If nothing says how fast a loop has to decay it decays a tenth as fast as the best start; its peak is the true one."""
    bounds = '{ peak = "suspension_deflection", road = "bump", at_most = 0.1 }, { gain = 3e4 }'
    controller, promises = designed(f"measured = {THREE}\n{BAND}\nbounds = [{bounds}]")
    assert max(pole.real for pole in controller.certificate.poles) < -0.02
    assert promises["largest suspension_deflection over bump"] <= 0.1


@pytest.mark.attack
def test_a_decay_is_of_the_poles_that_a_gain_moves():
    """A filter of 0.3 rad/s in z does not keep the loop from decaying at 0.5 rad/s."""
    text = vehicle_with(f"measured = {TWO}\nbounds = [{{ decay = 0.5 }}]").text
    slow = "sprung_acceleration = { numerator = [1.0], denominator = [1.0, 0.3] }"
    vehicle = parse_vehicle(text.replace("sprung_acceleration = 1.0", slow))
    controller = Designer(vehicle).design("goal")
    slowest = next(promise for promise in controller.specifications if promise.what == "slowest pole")
    assert slowest.holds
    assert slowest.value <= -0.5


def test_nothing_to_minimise_is_no_error():
    """The least force is none."""
    controller, promises = designed(
        'measured = ["suspension_deflection"]\nminimise = { signals = "control_force" }\nbounds = [{ norm = 40.0 }]'
    )
    assert np.abs(controller.gain).max() <= 1e-3
    assert promises["norm"] <= 40


@pytest.mark.attack
def test_a_band_with_errors(paper):
    """The norm with errors is at least that without, and that of any sample of the errors; proved lies above."""
    section = f'measured = {TWO}\nminimise = {{ signals = ["sprung_acceleration"], band = [0.5, 10.0] }}\n'
    vehicle = vehicle_with(section + "bounds = [{ gain = 2e4 }]\ntolerance = { sprung_velocity = 0.2 }")
    controller = Designer(vehicle).design("goal")
    without, with_errors = controller.specifications[:2]
    entry = vehicle.controllers["goal"]
    assert entry.goals is not None
    posed = goal_problem(vehicle, entry, entry.goals).members[0].posed[0]
    met = [
        norm_in_band(posed.plant.closed_loop(controller.gain * [1.0, 1.0 + error] @ posed.Cy), 0.5 * HZ, 10 * HZ).value
        for error in np.linspace(-0.2, 0.2, 41)
    ]
    assert with_errors.proved is not None
    assert without.value <= max(met) <= with_errors.value * (1 + 1e-9) <= with_errors.proved


@pytest.mark.attack
def test_json_of_the_shipped_goals():
    """Every promise of the shipped file is there in JSON, and holds."""
    done = shared.printed("synth", "--vehicle", "quarter_car_goals", "--json")
    assert done.code == 0
    rows = done.json["controllers"]
    promises = [promise for row in rows for promise in row.get("promises", [])]
    assert len(promises) >= 12
    assert all(promise["holds"] is True for promise in promises)


@pytest.mark.attack
def test_a_bound_with_errors_is_proved_where_it_is_kept():
    """The norm that is allowed is tried as what to prove, and so is the decay."""
    tolerance = "{ sprung_velocity = 0.1 }"
    section = f"measured = {ONE}\n{BAND}\nbounds = [{{ norm = 8.6 }}, {{ decay = 1.0 }}]\ntolerance = {tolerance}"
    controller = Designer(vehicle_with(section)).design("goal")
    with_errors = {promise.what: promise for promise in controller.specifications}
    assert with_errors["norm, with errors"].holds
    slowest = with_errors["slowest pole, with errors"]
    assert slowest.value <= -1.0
    assert slowest.holds
    assert slowest.proved == -1.0


def test_the_picture_of_two_loops(paper, designer):
    """The picture says which of two loops has the lowest peak: that of the least norm, as far as its points show it."""
    controllers = [designer.design(name) for name in ("II_printed", "state_printed")]
    rows = [Row(one.name, one, (), ()) for one in controllers]
    other, least = (one.certificate.norm.value for one in controllers)
    both, alone = responses_figure(paper, rows), responses_figure(paper, rows[:1])
    assert both is not None
    assert alone is not None
    assert alone.finding == ""
    name, said = both.finding.removesuffix(".").split(" has the lowest peak: ")
    assert name == "state_printed"
    assert least < other
    assert float(said) == pytest.approx(least, rel=1e-3)


@pytest.mark.attack
def test_the_picture_of_a_band(tmp_path, capsys):
    """Curves are the loops' largest gains, the band is shaded, and what is proved in it lies on no point of the curve there."""
    vehicle = vehicle_with(f"measured = {THREE}\n{BAND}\nbounds = [{KEPT}]")
    controller = shared.designed(vehicle, "goal")
    figure = responses_figure(vehicle, [Row("goal", controller, (), ())])
    assert figure is not None
    (panel,) = figure.panels
    assert isinstance(panel.ground, Spans)
    assert panel.ground.ends == ((4.0, 8.0),)
    response, level = panel.curves
    loop = controller.loop(vehicle)
    for at in (0, 700, -1):
        assert response.y[at] == pytest.approx(gain_at(loop, HZ * response.x[at]), rel=1e-9)
    inside = (response.x >= 4) & (response.x <= 8)
    assert response.y[inside].max() <= level.y[0] == controller.specifications[0].proved
    assert response.y.max() > 5 * level.y[0]  # what lies beside the band is not hidden
    path = tmp_path / "car.toml"
    path.write_text(f"{vehicle.text}gain = {controller.gain.tolist()}\n")  # which is designed already
    assert main_of("synth")(["--vehicle", str(path), "--controller", "goal", "--picture", str(tmp_path / "bands.png"), "-v"]) == 0
    assert "bands.png" in capsys.readouterr().out
    assert (tmp_path / "bands.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(InputError, match="is an input file"):
        main_of("synth")(["--vehicle", str(path), "--picture", str(path), "-v"])


@pytest.mark.attack
def test_an_energy_peak_beside_a_filter():
    """Whatever is minimised beside filters in [performance], a road's energy bounds a signal as where there are none."""
    bound = '{ energy_peak = "tyre_deflection", energy = 0.01, at_most = 0.05 }'
    section = f"measured = {TWO}\nminimise = {{ signals = {{ sprung_acceleration = 1.0 }} }}\nbounds = [{bound}]"
    plain = vehicle_with(section)
    filtered = parse_vehicle(
        plain.text.replace("sprung_acceleration = 1.0\n", 'sprung_acceleration = { filter = "iso2631_wk" }\n', 1)
    )
    assert filtered.filters
    one, other = (Designer(vehicle).design("goal") for vehicle in (plain, filtered))
    assert other.specifications[1].what == "largest tyre_deflection for roads of 0.01 m2/s"
    assert [each.value for each in other.specifications] == pytest.approx(
        [each.value for each in one.specifications], rel=1e-3
    )  # other starts


@pytest.mark.parametrize("signal", ["suspension_deflection", "control_force"])
def test_a_peak_of_a_loop_whose_poles_are_all_real(signal):
    """If no pole swings a road's response is computed as where one does, without a warning, and is the other solver's."""
    gain = [[10121.047619047633, -108653.04761904797, -1630.6525396825323, 5240.445079365075]]
    measured = '["suspension_deflection", "tyre_deflection", "sprung_velocity", "unsprung_velocity"]'
    bound = f'{{ peak = "{signal}", road = "bump", at_most = 1e4 }}'
    vehicle = vehicle_with(f"measured = {measured}\ngain = {gain}\nbounds = [{bound}]")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        controller = Designer(vehicle).design("goal")
    assert all(pole.imag == 0 for pole in controller.certificate.poles)
    response = continuous_response(vehicle, controller, Bump(), np.linspace(0.0, 4.0, 8001))
    peak = next(each for each in controller.specifications if "over bump" in each.what)
    assert peak.value == pytest.approx(np.abs(response[signal]).max(), rel=1e-5)  # its times are 0.5 ms apart


def boxed(seed: int) -> MultiObjectiveProblem:
    """A random plant whose sensors and actuators are off: only a norm in a band counts, and no bound speaks of poles."""
    rng = np.random.default_rng(seed)
    A = rng.standard_normal((2, 2)) * 2
    A = A - np.eye(2) * (np.linalg.eigvals(A).real.max() - 0.2)
    B, Bw, C = rng.standard_normal((2, 2)), rng.standard_normal((2, 1)), np.eye(3, 2) * [[1.0, 0.0]]
    plant = GeneralizedPlant(A, B, Bw, C, np.array([[0, 0], [0.1, 0], [0, 0.1]]), np.zeros((3, 1)))
    posed, errors = (
        MeasuredPlant(plant, rng.standard_normal((3, 2))),
        GainErrors(np.array([0.06, 0.115, 0.026]), np.array([0.03, 0.01])),
    )
    return MultiObjectiveProblem(
        (FamilyMember((posed,)),), NormSpecification(band=(1.0, 2.0)), errors, np.ones((2, 3), dtype=bool), gain=3.6
    )


def stable_in_its_box(seed: int) -> bool:
    """Whether a design is stable at all corners of its box and inside, by its loops as they read; proved, and so said, if so."""
    asked, rng = boxed(seed), np.random.default_rng(seed)
    design = multi_objective_design(asked, [np.zeros((2, 3)), *(rng.standard_normal((2, 3)) for _ in range(3))])
    posed, sides = asked.members[0].posed[0], np.concatenate([asked.tolerance.sensors, asked.tolerance.forces])
    corners = np.array(list(itertools.product((-1.0, 1.0), repeat=5)))
    slowest = -np.inf
    for signs in (*corners, *rng.uniform(-1, 1, (200, 5))):
        off = 1 + signs * sides
        loop = posed.plant.A + posed.plant.B @ (off[3:, None] * design.gain * off[:3]) @ posed.Cy
        slowest = max(slowest, float(np.linalg.eigvals(loop).real.max()))
    return slowest < 0 and design.unproved == ()


@pytest.mark.attack
@pytest.mark.parametrize("seed", [4, pytest.param(3, marks=pytest.mark.attack)])
def test_a_band_alone_leaves_no_loop_of_the_box_unstable(seed):
    """If only a norm in a band counts, errors that make a loop unstable are looked for all the same; it is proved."""
    assert stable_in_its_box(seed)


@pytest.mark.attack
@pytest.mark.parametrize("seed", range(5, 10))
def test_no_design_is_unstable_in_its_box(seed):
    """So of many random plants."""
    try:
        stable = stable_in_its_box(seed)
    except DesignError as error:
        stable = "makes every loop of the goals stable" in str(error)
    assert stable


def test_a_design_says_of_what_stability_is_not_proved():
    """For a gain that some errors make unstable it is said, by the member."""
    asked = boxed(3)
    found = MultiObjectiveDesign(np.zeros((2, 3)), 1.0, None, (), asked)  # the plant itself is unstable
    assert found.unproved == (0,)
    stable = replace(asked.members[0].posed[0].plant, A=-np.eye(2))
    members = (FamilyMember((replace(asked.members[0].posed[0], plant=stable),)), asked.members[0])
    assert replace(found, problem=replace(asked, members=members)).unproved == (1,)


def test_without_errors_poles_prove_stability():
    """Without errors a stable loop is proved by its poles, of plants too large for the proof of a box, and of discrete ones."""
    plant, Cy = chain(40)
    none, anywhere = GainErrors(np.zeros(1), np.zeros(1)), np.ones((1, 1), dtype=bool)
    for each in (plant, replace(plant, A=0.5 * np.eye(40), dt=0.1)):
        for growth, unproved in ((0.0, ()), (2.0, (0,))):
            moved = replace(each, A=each.A + growth * np.eye(40))
            asked = MultiObjectiveProblem(
                (FamilyMember((MeasuredPlant(moved, Cy[:1]),)),), NormSpecification(), none, anywhere, gain=5.0
            )
            assert MultiObjectiveDesign(np.zeros((1, 1)), 1.0, None, (), asked).unproved == unproved


def test_what_is_not_proved_has_no_bound():
    """A promise without a proved bound, as where a proof was ended early, says so, and is not kept."""
    open_ = Specification("norm", 6.0, proved=np.inf, at_most=7.0)
    assert open_.text == "norm 6, no bound proved; at most 7 is allowed"
    assert (open_.proved_text, open_.holds) == ("not proved", False)
    assert replace(open_, proved=6.5).text == "norm 6, proved to be at most 6.5; at most 7 is allowed"


@pytest.mark.attack
def test_errors_with_a_band_keep_a_decay(paper):
    """A band and errors alone: the slowest pole, whatever the errors, keeps a tenth of what the two steps' has with them."""
    text = f"measured = {TWO}\n{BAND}\ntolerance = {{ suspension_deflection = 0.1, sprung_velocity = 0.1 }}"
    vehicle = vehicle_with(text)
    entry = vehicle.controllers["goal"]
    assert entry.goals is not None
    design = run_search(goal_problem(vehicle, entry, entry.goals))
    posed = Designer(paper).problem(json.loads(TWO))
    two_steps = Designer(paper).design("I").gain

    def slowest(K: np.ndarray) -> float:
        corners = itertools.product((0.9, 1.1), repeat=2)
        return max(np.linalg.eigvals(posed.plant.A + posed.plant.B @ (K * off) @ posed.Cy).real.max() for off in corners)

    assert slowest(design.gain) <= 0.1 * slowest(two_steps) < -0.03


def test_ctrl_c_leaves_nothing(tmp_path, capsys, monkeypatch):
    """Ctrl-C during the design of a second controller prints nothing and saves nothing, also of the first one."""
    path, saved = tmp_path / "car.toml", tmp_path / "saved.toml"
    path.write_text(vehicle_with(f"measured = {ONE}\nbounds = [{{ norm = 9.0 }}]").text)

    def stopped(*given):
        raise KeyboardInterrupt

    monkeypatch.setattr("synth.vehicle.multi_objective.run_search", stopped)
    with pytest.raises(KeyboardInterrupt):
        main_of("synth")(["--vehicle", str(path), "--controller", "passive", "--controller", "goal", "--save", str(saved), "-v"])
    assert capsys.readouterr().out == ""
    assert not saved.exists()


def test_no_height_is_computed_twice(monkeypatch):
    """A point whose height is known is modelled, and its height told again, without another norm; a tighter bound is another."""
    vehicle = vehicle_with(f"measured = {TWO}\nbounds = [{{ norm = 9.0 }}]\ntolerance = {{ sprung_velocity = 0.1 }}")
    entry = vehicle.controllers["goal"]
    assert entry.goals is not None
    search = MinimaxSearch(goal_problem(vehicle, entry, entry.goals), lambda goal, within: None)
    minimax, x = search.minimax, search.full.point(np.array([[10000.0, -2000.0]]))
    true, calls = BandLandscape.norm, itertools.count()

    def counted(self, *given):
        next(calls)
        return true(self, *given)

    monkeypatch.setattr(BandLandscape, "norm", counted)
    height = minimax.evaluate(x)
    minimax.model(x, height, 0.1)
    assert minimax.evaluate(x) == height
    assert next(calls) == len(minimax.goals) + len(minimax.bounds) == 6  # two vertices and none, each minimised and bounded
    assert height.goal == max(true(term.landscape, x)[0] for term in search.norms())
    for term in minimax.bounds:
        term.unit /= 2
    assert minimax.evaluate(x).excess == pytest.approx(2 * height.excess + 1, rel=1e-12)
