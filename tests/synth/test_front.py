"""`python -m synth --front`: designs of which none beats another in all, each certified, above a line that nobody crosses."""

import csv
import json
import re
from dataclasses import replace

import numpy as np
import pytest

import synth.command.trade_off
import synth.vehicle.trade_off.front
import synth.vehicle.trade_off.lower_bound
from models.common.errors import InputError
from models.laws.linear import static_law
from models.vehicle.vehicle import Vehicle, parse_vehicle, read_vehicle
from sim.studies.frequency.trade_off import front_section, measure
from sim.studies.subject import Subject
from synth.__main__ import main
from synth.analysis.norm import largest_singular_values
from synth.command.trade_off import others_of
from synth.controller.problem import problem
from synth.vehicle.designer import Designer
from synth.vehicle.multi_objective import with_outputs_of_norm
from synth.vehicle.trade_off.axes import FrontAxis, axes_of, norm_on
from synth.vehicle.trade_off.continuation import rays, rays_of, undominated_rows
from synth.vehicle.trade_off.front import Front, _limits, entry_of, front
from synth.vehicle.trade_off.report import front_figure, line
from tests.support.commands import attacks, prose
from tests.support.shared import made

COUNT, QUICK = 6, 5
OMEGA = np.append(0.0, np.geomspace(1e-3, 1e4, 20000))  # rad/s


def found(asked: str, count: int = COUNT, name: str = "I", vehicle: Vehicle | None = None) -> Front:
    return made(found_anew, asked, count, name, vehicle or read_vehicle("quarter_car"))


def found_anew(asked: str, count: int, name: str, vehicle: Vehicle) -> Front:
    return front(vehicle, name, axes_of(vehicle, asked), others_of(vehicle), count)


@pytest.fixture(scope="module")
def few() -> Front:
    return found("ride:travel")


@pytest.fixture
def quick(monkeypatch):
    """Commands that design a few, above a line of a few points."""
    monkeypatch.setattr(synth.command.trade_off, "DESIGNS", QUICK)
    monkeypatch.setattr(synth.vehicle.trade_off.lower_bound, "RATIOS", FEW_RATIOS)


FEW_RATIOS = range(-1, 2)


def quick_front(vehicle: Vehicle, name: str, axes: tuple[FrontAxis, ...], others: tuple[str, ...]) -> Front:
    """Returns what `quick` commands design."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(synth.vehicle.trade_off.lower_bound, "RATIOS", FEW_RATIOS)
        return front(vehicle, name, axes, others, QUICK)


def values_at(vehicle: Vehicle, asked: str, K: np.ndarray, measured: tuple[str, ...], omega: np.ndarray) -> list[float]:
    """The norms of a gain on the axes, by a sweep of frequencies."""
    norms = []
    for axis in axes_of(vehicle, asked):
        plant = problem(with_outputs_of_norm(vehicle, axis.norm), measured, entry_of(vehicle, "I").hardware)
        loop = plant.plant.closed_loop(plant.closed_loop(static_law(K))[1])
        low, high = (2 * np.pi * edge for edge in axis.norm.band)
        within = np.unique(np.clip(omega, low, high))
        norms.append(float(largest_singular_values(loop.frequency_response(within)).max()))
    return norms


@pytest.mark.parametrize(
    ("asked", "count"),
    [
        ("ride:travel", COUNT),
        *attacks([("band=2-6:travel:force", 6), ("travel:tolerance=5", 3)]),
    ],
)
def test_none_beats_another_and_all_are_certified(asked, count):
    """No design is as good as another in all; each norm is proved to lie below its level, and so is that of [performance]."""
    front = found(asked, count)
    assert len(front.points) > count / 2
    assert front.unproved == 0
    values = front.values
    for i, one in enumerate(values):
        assert not any(np.all(other <= one) for j, other in enumerate(values) if j != i)
    for point in front.points:
        certificate = point.controller.certificate
        assert certificate.stable
        assert not certificate.failures
        assert certificate.bound is not None
        assert all(norm.value <= norm.proved < np.inf for norm in point.norms)


def test_norms_are_those_of_a_sweep(few):
    """Each norm is that of twenty thousand frequencies: none of them is above it, and next to one it is reached."""
    for point in few.points:
        swept = values_at(few.vehicle, "ride:travel", point.controller.gain, point.controller.measured, OMEGA)
        for norm, value in zip(point.norms, swept, strict=True):
            assert value <= norm.proved
            assert value == pytest.approx(norm.value, rel=1e-4)  # a peak between two of the frequencies, 1e-3 apart


@pytest.mark.attack
def test_no_gain_of_a_grid_beats_the_front(few):
    """For many gains, all over and around the front, none is better than a design in both by more than rounding."""
    generator = np.random.default_rng(18)
    gains = np.array([point.controller.gain for point in few.points])
    axes, entry = few.axes, entry_of(few.vehicle, "I")
    around = gains[generator.integers(len(gains), size=40)] * (1 + 0.1 * generator.standard_normal((40, 1, 2)))
    wide = gains.reshape(-1, 2).min(axis=0) + generator.random((40, 1, 2)) * np.ptp(gains.reshape(-1, 2), axis=0)
    for K in np.concatenate([around, wide]):
        norms = [norm_on(few.vehicle, axis, entry, static_law(K)).value for axis in axes]
        # A descent ends where a step promises less than 1e-7; ten times that is left for the step's own error.
        assert not any(np.all(np.array(norms) < np.array(point.values) * (1 - 1e-6)) for point in few.points)


@pytest.mark.attack
@pytest.mark.parametrize(
    ("axes", "random"),
    [
        ("ride:road_holding:force", False),
        *((axes, True) for axes in ("band:travel", "ride:force", "travel:road_holding")),
    ],
)
def test_nobody_crosses_the_line(axes, random):
    """On any vehicle no design, no other controller and no random gain on the whole state lies below a proved line."""
    generator, text = np.random.default_rng(4), read_vehicle("quarter_car").text
    for name, value in re.findall(r"^(\w+) = ([\d.]+) +# (?:kg|N/m|N s/m)$", text, re.M) if random else ():
        text = re.sub(rf"^{name} = .*$", f"{name} = {float(value) * 2 ** generator.uniform(-1, 1):.6g}", text, flags=re.M)
    vehicle = parse_vehicle(text)
    front = found(axes, 4, vehicle=vehicle)
    entry, states = entry_of(vehicle, "state"), len(vehicle.linear_model.states)
    wild = [np.array([1e4, 1e3, 1e4, 1e3]) * generator.standard_normal((1, states)) for _ in range(30)]
    some = [[norm_on(vehicle, axis, entry, static_law(K)).value for axis in front.axes] for K in wild]
    all_of_them = [*front.values.tolist(), *(one.values for one in front.others), *some]
    values = np.array([each for each in all_of_them if np.all(np.isfinite(each))])
    assert len(values) > len(front.points)
    assert front.limits
    for limit in front.limits:
        assert np.any(limit.norms > 0)
        assert np.min(limit.share(values[:, list(limit.axes)])) >= 1 - 1e-9  # norms are good to 1e-9


def test_a_norm_in_a_band_is_bounded_within_it(few, monkeypatch):
    """Between 3 and 3.1 Hz there is a line, and no design lies below it, though each has a larger norm elsewhere."""
    monkeypatch.setattr(synth.vehicle.trade_off.lower_bound, "RATIOS", range(1))
    monkeypatch.setattr(synth.vehicle.trade_off.lower_bound, "IN_BAND", 3)
    axes = axes_of(few.vehicle, "band=3-3.1:travel")
    (limit,) = _limits(few.vehicle, axes, np.zeros((0, 2)), ())
    entry, laws = entry_of(few.vehicle, "I"), [one.controller.law for one in few.points[::3]]
    values = np.array([[norm_on(few.vehicle, axis, entry, law).value for axis in axes] for law in laws])
    assert np.min(limit.share(values)) >= 1 - 1e-9
    assert np.all(values[:, 0] < few.values[::3, 0])
    assert limit.norms[2] > 0


def test_the_line_is_where_its_shares_are_one(few):
    """The line that is drawn lies in no ellipse that nobody enters, and on the border of one."""
    (limit,) = few.limits
    x, y = line(limit, (7.5, 12.0), (0.01, 0.8))
    shares = limit.share(np.stack([x, y], axis=1))
    assert shares == pytest.approx(1.0, abs=1e-9)  # rounding of a square root
    assert np.all(np.diff(x) >= 0)
    assert np.all(np.diff(y) <= 1e-12)


def test_the_picture_is_the_front(few):
    """Its curves are the designs, the line, and every other controller, which else is named with its numbers above."""
    (panel,) = front_figure(few).panels
    designs, limit, *others = panel.curves
    assert np.array_equal(np.stack([designs.x, designs.y], axis=1), few.values)
    assert limit.label == "lower bound for every controller"
    shown = {name for curve in others for name in curve.label.split(", ")}
    for one in few.others:
        name, (x, y) = one.controller.name, one.values
        if name in shown:
            (curve,) = [curve for curve in others if name in curve.label.split(", ")]
            assert abs(curve.x[0] - x) < 0.02 * x  # one mark for those in one place
            assert panel.xlim is not None
            assert panel.xlim[0] < x < panel.xlim[1]
        else:
            assert f"{name} ({x:.7g}, {y:.7g})" in panel.title
    assert "passive (35.07175, 1.33537)" in panel.title


def test_what_is_written_is_one(quick, capsys, monkeypatch, tmp_path):
    """CSV, JSON and saved controllers have the same numbers; twice the same command gives the same; --check agrees.

    A point that the front does not have is refused, and nothing is written.
    """
    table, saved, picture = tmp_path / "front.csv", tmp_path / "front.toml", tmp_path / "front.svg"
    arguments = ["--front", "ride:travel", "--csv", str(table), "--save", str(saved), "--point", "3", "5"]
    with monkeypatch.context() as patch:
        patch.setattr(synth.command.trade_off, "front", lambda *asked: made(quick_front, *asked[:4]))
        with pytest.raises(InputError, match="the front has only 5 points"):
            main([*arguments, "99"])
        assert not list(tmp_path.iterdir())
        assert main([*arguments, "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    before = table.read_text()
    assert main([*arguments, "--picture", str(picture)]) == 0
    printed = capsys.readouterr().out
    assert table.read_text() == before
    assert picture.read_text().startswith("<?xml")
    rows = list(csv.DictReader(before.splitlines()))
    assert [row["point"] for row in rows] == [
        *(str(point["point"]) for point in result["points"]),
        *(other["name"] for other in result["others"]),
    ]
    for row, one in zip(rows, [*result["points"], *result["others"]], strict=True):
        for axis in ("ride", "travel"):
            assert float(row[axis]) == one["values"][axis]["value"]
            assert float(row[f"{axis}_proved"]) == one["values"][axis]["proved"]
        assert float(row["norm"]) == one["norm"]
        if "point" in one:
            assert [float(row["gain_1_1"]), float(row["gain_1_2"])] == one["gain"][0]
            assert (float(row["bump_travel"]) if row["bump_travel"] else None) == one["bump_travel"]
    assert f"{len(result['points'])} certified designs, none better than another on all axes" in prose(printed)
    text = read_vehicle(saved)
    assert {"I_point_3_designed", "I_point_5_designed"} < {*text.controllers}
    law = text.controllers["I_point_3_designed"].law
    assert law is not None
    assert law.D.tolist() == result["points"][2]["gain"]
    assert main(["--check", str(saved), "--controller", "I_point_5_designed"]) == 0


@pytest.mark.attack
def test_bounds_of_the_section_are_kept():
    """Designs of a controller with goals keep their bounds, proved, as its own design does."""
    vehicle = read_vehicle("quarter_car_goals")
    front = found("band:travel", 4, "comfort", vehicle)
    assert len(front.points) > 2
    for point in front.points:
        assert not point.controller.unmet_specifications
        assert [promise.at_most for promise in point.controller.specifications[1:]] == [8.63, -1.19]
        assert point.controller.certificate.norm.value <= 8.63
    assert "comfort" not in {one.controller.name for one in front.others}  # designs for goals take seconds


@pytest.mark.attack
def test_report(monkeypatch, few):
    """A report with a front has its designs and what MuJoCo measures at some; in its figure they are what its table says."""
    pytest.importorskip("jinja2", reason="needs the extra [report]")
    monkeypatch.setattr("sim.studies.frequency.trade_off.front", lambda vehicle, name, axes, *_: replace(few, axes=axes))
    monkeypatch.setattr(synth.vehicle.trade_off.front, "MARKED_POINTS", 2)  # each is driven over two sinusoids
    designer = Designer(few.vehicle)
    scope = Subject(few.vehicle, designer, (designer.design("I"),), 2e-3, True, front="ride:travel")
    section = front_section(scope, lambda text: None)
    (table,), (figure,) = section.tables, section.figures
    norms = few.values[few.marked]
    assert [[float(row[1]), float(row[3])] for row in table.rows[:2]] == [
        pytest.approx(each, rel=1e-6) for each in norms.tolist()
    ]
    (measured,) = [curve for curve in figure.panels[0].curves if curve.name == "MuJoCo"]
    shown = np.stack([measured.x, measured.y], axis=1)
    assert [[float(row[2]), float(row[4])] for row in table.rows[:2]] == [
        pytest.approx(each, rel=1e-4) for each in shown.tolist()
    ]
    # A force held over a step acts half of that late, and the peak of a sinusoid is the norm to NEXT.
    assert np.max(np.abs(shown / norms - 1)) < 0.005
    assert f"{COUNT} certified designs, none better than another on all axes" in section.statements[0].text


@pytest.mark.attack
def test_mujoco_tends_to_the_norm(few):
    """The gain of a design in MuJoCo tends to its norm with the first power of the step over which forces are held."""
    scope = Subject(few.vehicle, Designer(few.vehicle), (), 1e-3, True)
    off = [measure(scope, few, 2, few.axes[0], turn) / few.points[2].values[0] - 1 for turn in (0.008, 0.004)]
    assert 0 < abs(off[1]) < 0.002
    assert off[0] / off[1] == pytest.approx(2, rel=0.1)  # the square of the step is left


def test_rays():
    """They are as many as are said, from end to end, neighbours next to one another."""
    for ends in (np.array([[1.0, 5.0], [4.0, 2.0]]), np.eye(3)):
        for count in (3, 10, 200):
            points = np.array(list(rays(ends, count)))
            assert len(points) == rays_of(len(ends), count)
            assert all(np.min(np.linalg.norm(points - end, axis=1)) < 1e-12 for end in ends)
            steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
            assert steps.max() < 1.0001 * steps.min()


def test_undominated():
    """For points that are alike one is left, and of others those that none is as good as in all."""
    generator = np.random.default_rng(1)
    values = generator.integers(0, 6, size=(200, 3)).astype(float)
    kept = undominated_rows(values)
    assert len(np.unique(values[kept], axis=0)) == kept.sum()
    for i, one in enumerate(values):
        beaten = any(np.all(other <= one) and np.any(other < one) for other in values)
        assert not (kept[i] and beaten)
        assert beaten or any(np.array_equal(one, other) for other in values[kept])
