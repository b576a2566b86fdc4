"""Foxglove and Lichtblick: the log's scene and events are in the published schemas, and the layout beside it fits the log."""

import json
import math
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from foxglove_schemas_protobuf.FrameTransforms_pb2 import FrameTransforms
from foxglove_schemas_protobuf.Log_pb2 import Log
from foxglove_schemas_protobuf.SceneUpdate_pb2 import SceneUpdate
from mcap_protobuf.schema import build_file_descriptor_set
from scipy.spatial.transform import Rotation

from sim.drive.response import difference
from sim.recording.foxglove_layout import foxglove_layout
from sim.recording.mcap_writer import write_mcap
from sim.recording.run_log import RunLog
from sim.recording.scene import BESIDE, LIFTED_COLOUR, LONGEST, Scene, arrows, rotation_matrix, strut_lines, tyre_surface
from tests.sim.test_recording import make_run, messages
from tests.support.npm import installed

PACKAGES = ("@mcap/core@2.2.2", "fzstd@0.1.1", "protobufjs@8.8.1", "@foxglove/schemas@2.1.0")
READER = Path(__file__).parent / "mcap_reader.mjs"
GRID = 2.0**-13 * 1.001  # m, half of the grid that moving lines and surfaces are drawn to


@pytest.fixture(scope="module")
def log(lifting: RunLog, tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("foxglove") / "run.mcap"
    write_mcap(path, [lifting], {}, {})
    return path


def read(path: Path) -> dict[str, list]:
    """(schema, record, decoded) of every message, by topic."""
    return {topic: [(schema, record, decoded) for schema, _, record, decoded in rows] for topic, rows in messages(path).items()}


def test_schemas_are_the_published_ones(log: Path) -> None:
    """The descriptors in the file are, byte for byte, those that Foxglove publishes."""
    found = read(log)
    for topic, published in (
        ("/transforms", FrameTransforms),
        ("/shapes", SceneUpdate),
        ("/scene", SceneUpdate),
        ("/events", Log),
    ):
        (schema,) = {schema.data for schema, *_ in found[topic]}
        assert schema == build_file_descriptor_set(published).SerializeToString()
        assert {schema.name for schema, *_ in found[topic]} == {published.DESCRIPTOR.full_name}


def test_transforms_place_every_body(lifting: RunLog, log: Path) -> None:
    """At every frame, every body is where the scene has it, exactly, under the run's own frame, under the world."""
    rows = read(log)["/transforms"]
    assert [record.log_time for _, record, _ in rows] == [round(t * 1e9) for t in lifting.scene.time]
    for index, (_, record, message) in enumerate(rows):
        own, *bodies = message.transforms
        assert (own.parent_frame_id, own.child_frame_id) == ("world", "I")
        assert {one.timestamp.ToNanoseconds() for one in message.transforms} == {record.log_time}
        for one, (body, motion) in zip(bodies, lifting.scene.bodies.items(), strict=True):
            assert (one.parent_frame_id, one.child_frame_id) == ("I", f"I/{body}")
            assert [one.translation.x, one.translation.y, one.translation.z] == motion.positions[index].tolist()
            turned = [one.rotation.w, one.rotation.x, one.rotation.y, one.rotation.z]
            assert turned == motion.quaternions[index].tolist()


def test_every_solid_is_drawn_once(lifting: RunLog, log: Path) -> None:
    """One message holds the solids of every body, fixed to its frame; a capsule is a cylinder with two balls."""
    ((_, _, update),) = read(log)["/shapes"]
    drawn = {entity.id: (len(entity.cubes), len(entity.cylinders), len(entity.spheres)) for entity in update.entities}
    for body in lifting.scene.bodies:
        forms = [shape.form for shape in lifting.scene.shapes if shape.body == body]
        capsules = forms.count("capsule")
        assert drawn[body] == (forms.count("box"), forms.count("cylinder") + capsules, forms.count("sphere") + 2 * capsules)
    assert all(entity.frame_locked for entity in update.entities)


def test_struts_and_tyres_are_those_of_the_scene(lifting: RunLog, log: Path) -> None:
    """At every frame a strut's lines and a tyre's surface are where the scene has them; in the air the tyre is red."""
    (tyre,), (ends,) = lifting.scene.tyres, lifting.scene.springs.values()
    assert tyre.lifted.any()
    assert not tyre.lifted.all()
    expected = [*strut_lines(ends), tyre_surface(tyre)[0]]
    for index, (_, _, update) in enumerate(read(log)["/scene"]):
        (surface,) = (entity.triangles[0] for entity in update.entities if entity.id == "tyre")
        for drawn, points in zip((*update.entities[0].lines, surface), expected, strict=True):
            np.testing.assert_allclose([[at.x, at.y, at.z] for at in drawn.points], points[index], atol=GRID)
        assert (round(255 * surface.color.r) == LIFTED_COLOUR[0]) == tyre.lifted[index]
        assert max(surface.indices) == len(surface.points) - 1


def test_squeeze_is_that_of_the_physics(lifting: RunLog) -> None:
    """The hub's height over the road is the tyre's length in MuJoCo: static length plus tyre deflection, by another way."""
    (tyre,) = lifting.scene.tyres
    physics = lifting.responses["mujoco"]
    frames = np.searchsorted(physics.time, lifting.scene.time - 1e-9)
    static = (504.5 + 62.0) * 9.81 / 252000.0  # of the vehicle that ships
    # Both are lengths in double precision, of less than 1 m.
    np.testing.assert_allclose(tyre.height, tyre.radius - static + physics["tyre_deflection"][frames], atol=1e-12)


def test_arrow_is_the_control_force(lifting: RunLog, log: Path) -> None:
    """An arrow beside the strut points up where the force lifts the body, and is as long as its share of the largest force."""
    physics = lifting.responses["mujoco"]
    frames = np.searchsorted(physics.time, lifting.scene.time - 1e-9)
    force = physics["control_force"][frames]
    ends = lifting.scene.springs["suspension"]
    seen = 0
    for index, (_, _, update) in enumerate(read(log)["/scene"]):
        arrows = update.entities[1].arrows
        if not arrows:
            assert abs(force[index]) < 0.01 * abs(force).max()
            continue
        (arrow,) = arrows
        turn = arrow.pose.orientation
        direction = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).apply([1.0, 0.0, 0.0])
        vector = direction * (arrow.shaft_length + arrow.head_length)
        np.testing.assert_allclose(vector, [0, 0, LONGEST * force[index] / abs(force).max()], atol=1e-12)
        tail = arrow.pose.position
        np.testing.assert_allclose([tail.x, tail.y, tail.z], ends[index].mean(axis=0) + BESIDE, atol=1e-12)
        seen += 1
    assert seen > 10


@pytest.mark.parametrize("force", [800.0, -800.0])
def test_arrow_lies_along_a_strut_that_leans(force: float) -> None:
    """Off the middle of a body that leans, it points from the wheel's end to the body's, or back where the force pulls."""
    bottom, top = np.array([1.2, -0.7, 0.3]), np.array([1.1, -0.6, 0.8])
    scene = Scene(np.zeros(1), (), {}, {"strut": np.array([[bottom, top]])}, forces={"strut": np.array([force])})
    _, ((vector,),) = zip(*arrows(scene, 1000.0).values(), strict=True)
    np.testing.assert_allclose(vector, LONGEST * force / 1000.0 * np.array([-0.1, 0.1, 0.5]) / math.sqrt(0.27), atol=1e-12)


def test_differences_are_logged(lifting: RunLog, log: Path) -> None:
    """`/difference` is MuJoCo minus linear over the peak of linear, in single precision, for all that the vehicle makes."""
    rows = read(log)["/difference"]
    physics, linear = lifting.responses["mujoco"], lifting.responses["linear"]
    gap = difference(physics, linear)
    assert set(gap.names) == set(physics.names) - {"road_displacement", "road_velocity"}
    for name in gap.names:
        expected = (physics[name] - linear[name]) / abs(linear[name]).max()
        logged = [getattr(message, name) for *_, message in rows]
        np.testing.assert_allclose(logged, expected, rtol=1e-7, atol=1e-300)  # 24 bits


def panels_of(node: Any) -> Iterator[str]:
    """Ids of the panels in a layout's tree."""
    if isinstance(node, str):
        yield node
    else:
        assert 0 < node["splitPercentage"] < 100
        assert node["direction"] in ("row", "column")
        yield from panels_of(node["first"])
        yield from panels_of(node["second"])


@pytest.mark.parametrize("names", [["I"], ["I", "II"], ['my/own: é "#1"', "I 1", "I_201"]])
def test_layout_fits_its_log(names: list[str], tmp_path: Path) -> None:
    """Every curve is a field of a topic in the file, every 3D topic is there, and every panel is placed exactly once.

    Its cameras look at the middle of what they show.
    """
    runs = [make_run(name) for name in names]
    write_mcap(tmp_path / "runs.mcap", runs, {}, {})
    topics = read(tmp_path / "runs.mcap")
    layout = json.loads(foxglove_layout(runs))
    placed = list(panels_of(layout["layout"]))
    for panel in placed:  # it grows: a tab holds more
        for tab in layout["configById"][panel].get("tabs", []):
            placed += panels_of(tab["layout"])
    assert sorted(placed) == sorted(layout["configById"])

    curves = [
        path["value"] for name, panel in layout["configById"].items() if name.startswith("Plot!") for path in panel["paths"]
    ]
    assert len(curves) > 10 * len(names)
    for curve in curves:
        topic, _, field = curve.rpartition(".")
        topic = json.loads(topic) if topic.startswith('"') else topic
        assert field in {known.name for known in topics[topic][0][2].DESCRIPTOR.fields}
    transforms = [one for run in topics if run.endswith("/transforms") for one in topics[run][0][2].transforms]
    places = [(one.translation.x, one.translation.y, one.translation.z) for one in transforms if one.parent_frame_id == "world"]
    centre = np.mean(runs[0].scene.finite().extent(), axis=0)
    for panel in (panel for name, panel in layout["configById"].items() if name.startswith("3D!")):
        assert set(panel["topics"]) <= set(topics)
        assert panel["followTf"] in {"world", *(one.child_frame_id for one in transforms)}
        row = np.mean(places, axis=0) if panel["followTf"] == "world" else 0.0  # else one car is followed
        np.testing.assert_allclose(panel["cameraState"]["targetOffset"], row + centre, atol=1e-9)


@pytest.fixture(scope="module")
def node_modules(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """JavaScript's own readers, from the npm registry."""
    return installed(PACKAGES, tmp_path_factory.mktemp("node"))


@pytest.mark.attack
@pytest.mark.slow
def test_another_language_reads_the_same(log: Path, node_modules: Path) -> None:
    """@mcap/core and protobufjs find the topics, times and numbers that Python finds.

    Every message with a published schema is valid by Foxglove's JSON schema of that name.
    """
    jsonschema = pytest.importorskip("jsonschema")
    output = subprocess.run(["node", READER, node_modules, log], check=True, capture_output=True, text=True, timeout=120).stdout
    theirs, ours = json.loads(output), read(log)
    assert set(theirs["topics"]) == set(ours)
    for topic, rows in ours.items():
        found = theirs["topics"][topic]
        assert found["schema"] == rows[0][0].name
        assert found["times"] == [str(record.log_time) for _, record, _ in rows]
        if found["schema"].startswith("foxglove."):
            valid = jsonschema.Draft7Validator(theirs["published"][found["schema"]])
            for message in found["messages"]:
                valid.validate(message)
        else:  # to the bit: JSON holds the shortest text that reads back as the same number
            fields = [field.name for field in rows[0][2].DESCRIPTOR.fields]
            assert found["messages"] == [{field: getattr(message, field) for field in fields} for *_, message in rows]
    for message, (*_, own) in zip(theirs["topics"]["/transforms"]["messages"], ours["/transforms"], strict=True):
        for one, other in zip(message["transforms"], own.transforms, strict=True):
            place = other.translation
            assert one["translation"] == {"x": place.x, "y": place.y, "z": place.z}
    happened = [(event["message"], event["name"], event["level"]) for event in theirs["topics"]["/events"]["messages"]]
    assert [text for text, *_ in happened[:2]] == ["lift-off", "landing"]
    assert {(name, level) for _, name, level in happened} == {("I", Log.INFO)}


def test_rotation_of_a_quaternion():
    """A quaternion turns as scipy's has it, whatever its length."""
    for quaternion in np.random.default_rng(1).normal(size=(20, 4)):
        expected = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()
        np.testing.assert_allclose(rotation_matrix(quaternion), expected, atol=1e-15)  # rounding of numbers up to 1
