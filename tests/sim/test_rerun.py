"""Views of Rerun beside plain curves: tyres, struts and forces, differences, what happened, several controllers."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun.blueprint as rrb

from models.document.figure import rgb, styles
from models.roads.iso8608 import Iso8608
from models.roads.road import Road
from models.vehicle.vehicle import read_vehicle
from sim.drive.response import Response, difference
from sim.recording.pages import NEUTRAL, OVERVIEW, ROADS, SEEN, colour_of, groups, pages
from sim.recording.rerun_contents import GROUND
from sim.recording.rerun_writer import _comparison, _page, extremes_text, value_axis, write_rrd
from sim.recording.run_log import RunLog
from sim.recording.run_records import run_log
from sim.recording.scene import LIFTED_COLOUR, LONGEST, ROAD
from sim.runs.run import run_controllers, sample_times
from synth.vehicle.designer import Designer
from tests.sim.test_recording import make_run
from tests.support.commands import attacks

GREATEST = 1e-6  # m; Rerun's 3D is single precision, on coordinates below 2 m


@pytest.fixture(scope="module")
def log(lifting: RunLog, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rerun") / "run.rrd"
    write_rrd(path, [lifting], {"vehicle": "quarter_car"})
    return path


def rows(path: Path, entity: str, component: str) -> list:
    """A component of an entity, all instances of every row, in the order of time; one row where it is static."""
    from rerun.chunk import RrdReader

    found: list = []
    for chunk in RrdReader(path).stream().to_chunks():
        if chunk.entity_path == entity:
            batch = chunk.to_record_batch()
            if component in batch.schema.names:
                found += batch.column(component).to_pylist()
    return found


def entities(path: Path) -> set[str]:
    from rerun.chunk import RrdReader

    return {chunk.entity_path for chunk in RrdReader(path).stream().to_chunks()}


def test_tyre_gives_way_and_lifts(lifting: RunLog, log: Path) -> None:
    """At every frame a tyre's lowest point is on the road, or its own radius below the hub; in the air it is red."""
    (tyre,) = lifting.scene.tyres
    vertices = np.array(rows(log, "/I/world/unsprung/tyre", "Mesh3D:vertex_positions"))
    np.testing.assert_allclose(vertices[..., 2].min(axis=1), -np.minimum(tyre.radius, tyre.height), atol=GREATEST)
    np.testing.assert_allclose(abs(vertices[..., 1]).max(), tyre.half_width, atol=GREATEST)
    colours = np.array(rows(log, "/I/world/unsprung/tyre", "Mesh3D:albedo_factor"))[:, 0]
    red = np.uint32(int.from_bytes([*LIFTED_COLOUR, 255], "big"))
    np.testing.assert_array_equal(colours == red, tyre.lifted)


def test_strut_and_force(lifting: RunLog, log: Path) -> None:
    """The rod goes from wheel to body, and the arrow is the control force on the scale of the largest."""
    ends = lifting.scene.springs["suspension"]
    strips = rows(log, "/I/world/springs/suspension", "LineStrips3D:strips")
    np.testing.assert_allclose([strip[1] for strip in strips], ends, atol=GREATEST)
    force = lifting.scene.forces["suspension"]
    arrows = np.array(rows(log, "/I/world/forces/suspension", "Arrows3D:vectors"))[:, 0]
    np.testing.assert_allclose(arrows[:, 2], LONGEST * force / abs(force).max(), atol=GREATEST)
    np.testing.assert_allclose(arrows[:, :2], 0.0, atol=GREATEST)


@pytest.mark.parametrize(
    ("kind", "road", "tracks"),
    [
        ("quarter_car", Iso8608("C", speed=20.0), 1),
        *attacks([("full_car", Iso8608("C", speed=20.0, track_width=1.51), 2)]),
    ],
)
def test_the_road_is_drawn_under_the_wheels(kind: str, road: Road, tracks: int, tmp_path: Path) -> None:
    """At every frame each track lies, where a wheel is, as high as the physics has the road under it, and goes on before it."""
    vehicle = read_vehicle(kind)
    run = run_log(
        run_controllers(vehicle, [Designer(vehicle).design("passive")], road, sample_times(vehicle, 0.7, 1e-3))[0], "passive"
    )
    write_rrd(tmp_path / "run.rrd", [run], {})
    scene, physics = run.scene, run.responses["mujoco"]
    found = {entity.split("/")[4] for entity in entities(tmp_path / "run.rrd") if entity.startswith("/passive/world/profile/")}
    assert len(found) == tracks
    frames = np.searchsorted(physics.time, scene.time - 1e-6)
    under = []
    for name in found:
        ((edge,),) = rows(tmp_path / "run.rrd", f"/passive/world/profile/{name}/edge", "LineStrips3D:strips")
        moved = np.array(rows(tmp_path / "run.rrd", f"/passive/world/profile/{name}", "Transform3D:translation"))[:, 0]
        np.testing.assert_allclose(moved, np.outer(-road.speed * scene.time, [1, 0, 0]), atol=GREATEST)
        edge = np.array(edge)
        for wheel in vehicle.kind.wheels:
            place = scene.bodies[wheel.road_body].positions[0]
            if abs(edge[0, 1] - place[1]) > ROAD + GREATEST:
                continue  # a wheel of the other track
            under.append(wheel.road_body)
            assert not any(entity.startswith(f"/passive/world/{wheel.road_body}/") for entity in entities(tmp_path / "run.rrd"))
            height = np.interp(place[0] - moved[:, 0], edge[:, 0], edge[:, 2])
            # Rerun's 3D is single precision: positions up to 30 m are rounded by 2e-6 m, and no slope here is above 0.3.
            np.testing.assert_allclose(height, physics[wheel.road_displacement][frames], atol=GREATEST)
            ahead = np.interp(place[0] + 3.0 - moved[:, 0], edge[:, 0], edge[:, 2])
            later = road.displacement(scene.time + (3.0 - wheel.behind(vehicle.parameters)) / road.speed, wheel.side)
            # Between points 5 cm apart a line cuts off what has wavelengths below 10 cm: 0.5 mm rms of class C.
            np.testing.assert_allclose(ahead, later, atol=2e-3)
    assert sorted(under) == sorted(wheel.road_body for wheel in vehicle.kind.wheels)


def test_differences_are_those_of_the_verdict(lifting: RunLog, log: Path) -> None:
    """The difference's largest value before lift-off is the error that the run's verdict states, signal by signal."""
    physics, linear = lifting.responses["mujoco"], lifting.responses["linear"]
    gap = difference(physics, linear)
    errors = json.loads(lifting.metadata["errors"])
    until = gap.time < lifting.events[0][0] - 5e-3  # the comparison ends within a few steps of the lift-off
    found = {}
    for group, signals in groups([lifting]).items():
        *shown, after = rows(log, f"/I/difference/{group}", "Scalars:scalars")
        assert all(map(np.isnan, after))  # the plot goes on a little after the end
        found |= dict(zip([signal.name for signal in signals], np.transpose(shown), strict=True))
    assert set(found) == set(gap.names)
    for name, logged in found.items():
        np.testing.assert_array_equal(logged, gap[name])
        # The verdict's peak is that of the time before lift-off, and no larger than that of the whole run.
        assert abs(logged[until]).max() <= errors[name] * (1 + 1e-12)


def test_what_happened_is_marked_on_every_curve(lifting: RunLog, log: Path) -> None:
    """Each lift-off and landing is a point on MuJoCo's curve, at its time, for every signal."""
    physics = lifting.responses["mujoco"]
    assert {text for _, text in lifting.events} == {"lift-off", "landing"}
    for text in ("lift-off", "landing"):
        times = [time for time, what in lifting.events if what == text]
        for signal in physics.names:
            values = rows(log, f"/I/signals/{signal}/{text}", "Scalars:scalars")
            expected = [physics[signal][round(time / 1e-3)] for time in times]  # events are at samples of 1 ms
            assert [value[0] for value in values] == expected


def test_several_controllers_are_side_by_side(tmp_path: Path) -> None:
    """One file has every controller's car, curves and text, and one table of what is proved of each."""
    runs = [make_run("I"), make_run("II")]
    write_rrd(tmp_path / "two.rrd", runs, {})
    found = entities(tmp_path / "two.rrd")
    for name in ("I", "II"):
        assert {f"/{name}/world/sprung", f"/{name}/signals/control_force/linear", f"/{name}/summary"} <= found
    ((table,),) = rows(tmp_path / "two.rrd", "/certificates", "TextDocument:text")
    assert "| I | 6.3 | - | - |\n" in table  # nothing wide: a view cuts a table, and breaks sentences
    assert "| II | 6.3 |" in table
    assert table.endswith("\n`I`, `II`: agrees until 0.1 s (lift-off); first: tyre leaves the road, 0.05 s")


@pytest.mark.parametrize("wheels", ["", "0123"])
@pytest.mark.parametrize("count", [1, 2])
def test_pages(lifting: RunLog, wheels: str, count: int) -> None:
    """A page has at most six plots: acceleration, travel, tyre and force of one corner first, last the road, with each curve
    once, and between them, once, all other signals and all that have one for each wheel.
    """
    run = (
        lifting if not wheels else replace(lifting, responses={"mujoco": _with_signals(lifting.responses["mujoco"], len(wheels))})
    )
    runs = [run, replace(run, name="other")][:count]
    first, *between, last = pages(runs, runs)
    assert max(len(page.plots) for page in (first, *between)) <= SEEN
    overview = [f"{name}{wheels[:1]}" for name in OVERVIEW]
    assert [plot.curves[0].signal for plot in first.plots] == overview
    assert [curve.signal.rstrip("0") for plot in last.plots for curve in plot.curves] == [*ROADS]
    names = {name for name in run.responses["mujoco"].names if not name.startswith("road")}
    plotted = sorted(plot.curves[0].signal for page in between for plot in page.plots)
    assert plotted == sorted(names if wheels else names - {*overview})


def _contrast(color: str, ground: str) -> float:
    """The contrast of two colours, by WCAG."""
    parts = np.array([rgb(color), rgb(ground)]) / 255
    low, high = sorted(np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4) @ [0.2126, 0.7152, 0.0722])
    return (high + 0.05) / (low + 0.05)


def test_colours_are_the_report_s_and_readable(lifting: RunLog) -> None:
    """Every run has the report's colour, or a grey for its black; its contrast is 3 on white and on Rerun's ground."""
    runs = [replace(lifting, name=name) for name in ("passive", "state", "I", "II", *"0123456")]
    colours = {run.name: colour_of(runs, run) for run in runs}
    assert colours == {name: style.color for name, style in styles((*colours,)).items()} | {"passive": NEUTRAL}
    for colour in colours.values():
        assert min(_contrast(colour, "#ffffff"), _contrast(colour, f"#{3 * f'{GROUND:02x}'}")) > 2.99  # in whole parts of 255


def test_a_layout_is_of_one_recording(lifting: RunLog, tmp_path: Path) -> None:
    """Recordings with the same names have layouts of their own: the viewer keeps one per application."""
    from rerun.chunk import RrdReader

    for name in ("one", "other"):
        write_rrd(tmp_path / name, [replace(lifting, metadata={"vehicle": name})], {})
    one, other = (RrdReader(tmp_path / name).recordings()[0].application_id for name in ("one", "other"))
    assert one != other


def _range(plot: rrb.TimeSeriesView) -> tuple[float, float]:
    axis: Any = plot.properties["ScalarAxis"]
    (limits,) = axis.range.as_arrow_array().to_pylist()
    return limits[0], limits[1]


def test_every_plot_shows_its_curves_whole(lifting: RunLog) -> None:
    """The axis of every plot reaches beyond the least and the greatest value of its curves, or both sides of a constant."""
    for page in (_page([lifting], lifting), _comparison([lifting, replace(lifting, name="other")])):
        plots = [each for each in _parts(page) if isinstance(each, rrb.TimeSeriesView)]
        for plot in plots:
            low, high = _range(plot)
            name = str(plot.name).split("   ")[0].replace(" ", "_")
            if name in lifting.responses["mujoco"].names:
                curve = lifting.responses["mujoco"][name]
                assert low < curve.min()
                assert curve.max() < high
            else:
                assert name.startswith("difference")
        assert len(plots) >= len(lifting.responses["mujoco"].signals)


def test_a_plot_says_how_far_its_curves_go(lifting: RunLog) -> None:
    """Beside its signal's name and unit a plot has the least and the greatest value of what it shows."""
    physics = lifting.responses["mujoco"]
    parts = _parts(_comparison([lifting, replace(lifting, name="other")]))
    (name,) = {str(part.name) for part in parts if str(part.name).startswith("tyre deflection")}
    low, high = float(np.nanmin(physics["tyre_deflection"])), float(np.nanmax(physics["tyre_deflection"]))
    assert name == f"tyre deflection   z_u - z_r [m]   {low:.3g} to {high:.3g}"
    assert extremes_text([np.zeros(3), np.full(2, np.nan)]) == "0"
    assert extremes_text([np.full(2, np.nan)]) == ""


def test_an_axis_of_no_numbers_is_left_to_rerun() -> None:
    """A signal that is nowhere finite has no range, and does not spoil that of others."""
    nothing = np.full(5, np.nan)
    assert value_axis([nothing]) is None
    assert value_axis([np.array([-1e308, 7e307])]) is None  # the range is finite, but not with its margins
    (low, high) = _range(rrb.TimeSeriesView(axis_y=value_axis([nothing, np.array([0.0, 3.0, np.inf])])))
    assert low < 0 < 3 < high < 4
    (low, high) = _range(rrb.TimeSeriesView(axis_y=value_axis([np.full(3, 2.0)])))
    assert low < 2 < high


def _with_signals(response: Response, times: int) -> Response:
    """A response with as many signals of each kind as a car of several wheels has."""
    signals = tuple(replace(signal, name=f"{signal.name}{i}") for signal in response.signals for i in range(times))
    return Response(response.time, signals, np.repeat(response.values, times, axis=1))


def _parts(container) -> list:
    inner = list(getattr(container, "contents", []))
    return inner + [part for each in inner if isinstance(each, rrb.Container) for part in _parts(each)]
