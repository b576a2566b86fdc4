"""A rig's drive file: heights over time under each wheel, as they were written, in MuJoCo and analysis, in logs and campaigns."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from models.common.errors import InputError
from models.roads.choice import choose_road
from models.roads.description import described_road
from models.roads.iri import roughness_of
from models.roads.profile import Profile
from models.roads.rig import Rig
from models.roads.road import track_width, under_wheels
from models.vehicle.vehicle import read_vehicle
from sim.campaign.__main__ import main as campaign
from sim.campaign.file import read_campaign
from sim.drive.__main__ import main
from sim.inspect.__main__ import main as inspect
from sim.runs.run import run_controllers, sample_times
from synth.vehicle.designer import design
from tests.support.commands import refused

QUARTER, HALF, CAR = (read_vehicle(name) for name in ("quarter_car", "half_car", "full_car"))
CORNERS = ("front_left", "front_right", "rear_left", "rear_right")


def history(posts=CORNERS, end: float = 2.0, step: float = 0.01, seed: int = 0) -> Rig:
    """Posts that move by some millimetres, each in its own way, at uneven times."""
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.5, 1.5, round(end / step))) * step + 7.0
    omega, phase = rng.uniform(5, 30, len(posts)), rng.uniform(0, 6, len(posts))
    return Rig(
        time, 0.005 * np.sin(np.outer(time, omega) + phase) + rng.uniform(-0.1, 0.1, len(posts)), tuple(posts), "drive.csv"
    )


def written(rig: Rig, path, posts=None, scale: float = 1e3, unit: str = "mm") -> None:
    """A drive file."""
    heads = ", ".join(["time [s]", *(f"{name} [{unit}]" for name in posts or rig.posts)])
    rows = np.column_stack([rig.time, scale * rig.heights]).tolist()
    path.write_text(heads + "\n" + "\n".join(", ".join(map(repr, row)) for row in rows) + "\n")


def test_a_profile_is_a_history_at_its_speed():
    """Posts that move as a smooth profile does that is driven over give the same run: 1e-9 of peak."""
    speed, x = 12.5, np.arange(200) * 0.1
    heights = np.repeat((0.004 * np.sin(2 * np.pi / 11 * x) ** 3)[:, None], 2, axis=1)  # level over the first and the last 11 m
    driven = Profile(
        x, heights - np.interp(x, [8.9, 19.9], [0, heights[-1, 0] - heights[-111, 0]])[:, None], speed, join="smooth"
    )
    heights = driven.heights
    stood = Rig(x / speed, heights[:, :1], ("road_displacement",))
    time, passive = sample_times(QUARTER, 1.5, 1e-3), design(QUARTER, "passive")
    (one,), (other,) = (run_controllers(QUARTER, [passive], road, time) for road in (driven, stood))
    for name in one.physics.names:
        scale = one.physics.scale(name)
        assert np.abs(one.physics[name] - other.physics[name]).max() <= 1e-9 * scale, name  # rounding of x over speed
        assert np.abs(one.continuous[name] - other.continuous[name]).max() <= 1e-9 * scale, name


@pytest.mark.parametrize("name", ["quarter_car", "half_car", "full_car"])
def test_physics_agrees(name):
    """MuJoCo on moving posts follows the sampled response: to RK4's own error, or in a car to first order in its height."""
    vehicle = read_vehicle(name)
    posts = [wheel.road_displacement for wheel in vehicle.kind.wheels]
    rig = history(posts)
    time = sample_times(vehicle, 2.0, 1e-3)
    (run,) = run_controllers(vehicle, [design(vehicle, "I")], rig, time)
    assert run.passed
    assert not math.isfinite(run.agreement.until)
    for wheel, post in zip(vehicle.kind.wheels, posts, strict=True):
        assert np.array_equal(run.physics[wheel.road_displacement], rig.displacement(time, post))
    assert roughness_of(rig, vehicle, 100.0) == ()  # nothing of it lies along a way


@pytest.mark.parametrize(
    ("text", "settings"),
    [
        ("# from the rig\n\nREAR (cm); Time (ms); Front (m)\n0,1;0;0\n0,3;1e2;0,002\n# pause\n0,5;2e2;0,004\n0,8;300;,006\n", ""),
        ("time\tfront\trear\n0\t0\t1\n100\t2\t3\n200\t4\t5\n300\t6\t8\n", ":time_unit=ms:height_unit=mm"),
        ("time [s]  rear [mm]  other [kN]  front [mm]\n0 1 9 0\n0.1 3 9 2\n.2 5 9 4\n.3 8 9 6\n".replace(" [kN]", " [m]"), ""),
        ("\ufefft [sec], road_displacement_rear [mm], road_front [mm]\r\n0,1,0\r\n0.1,3,2\r\n0.2,5,4\r\n0.3,8,6\r\n", ""),
    ],
    ids=["other units and decimals", "units asked for", "more columns", "names of signals and bodies"],
)
def test_files(text, settings, tmp_path):
    """Columns are found by their names, in the units that are written above them or asked for."""
    (tmp_path / "drive.csv").write_text(text)
    rig = choose_road(f"rig:file=drive.csv{settings}", tmp_path).build(HALF, 20.0, 0, 1.0)
    t = np.array([0.0, 0.1, 0.2, 0.3])
    found = under_wheels(rig.displacement, rig, HALF, t)
    assert np.allclose(found - found[0, 0], 1e-3 * np.array([[0, 1], [2, 3], [4, 5], [6, 8]]), rtol=0, atol=1e-15)


@pytest.mark.parametrize("names", ["FL FR RL RR", "lf rf lr rr", "Front-Left Front-Right rear-left REAR_RIGHT"])
def test_short_names(names, tmp_path):
    """Corners may be called as rigs call them."""
    rig = history(end=0.5)
    written(rig, tmp_path / "drive.csv", names.split())
    found = choose_road("rig:file=drive.csv", tmp_path).build(CAR, 20.0, 0, 1.0)
    t = rig.time - rig.time[0]
    own, other = (under_wheels(one.displacement, one, CAR, t) for one in (rig, found))
    assert np.allclose(own, other, rtol=0, atol=1e-15)  # times 1000 and back


def test_log_and_campaign(tmp_path, capsys):
    """A log proves its run when the drive file is gone, and not with another one; a campaign has the same numbers."""
    written(history(), tmp_path / "drive.csv")
    text = f"rig:file={tmp_path / 'drive.csv'}"
    command = ["--vehicle", "full_car", "--controller", "passive", "--road", text, "--duration", "0.1"]
    assert main([*command, "--logs", str(tmp_path / "logs"), "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert result["iri"] == {}
    assert result["road"]["posts"] == " ".join(CORNERS)
    (tmp_path / "campaign.toml").write_text(
        'vehicles = ["full_car"]\ncontrollers = ["passive"]\nroads = ["rig:file=drive.csv"]\nspeeds = [10.0]\nduration = 0.1\n'
    )
    assert campaign([str(tmp_path / "campaign.toml"), "--results", str(tmp_path / "results"), "--workers", "1", "--json"]) == 0
    import pyarrow.parquet as parquet

    (file,) = (tmp_path / "results").glob("*.parquet")
    (row,) = parquet.read_table(file).to_pylist()
    for name, metric in result["runs"][0]["metrics"].items():
        assert row[name] == pytest.approx(metric["mujoco"], rel=1e-9, abs=1e-12), name  # blocks may add up in another order
    (log,) = (tmp_path / "logs").glob("*.mcap")
    (tmp_path / "drive.csv").unlink()
    capsys.readouterr()
    assert inspect([str(log)]) == 0


def test_what_is_twice_in_a_campaign(tmp_path):
    """A campaign has the same drive file once, and another one that differs by who stands on which post."""
    rig = history(end=0.5)
    written(rig, tmp_path / "drive.csv")
    written(rig, tmp_path / "other.csv", [*CORNERS[2:], *CORNERS[:2]])
    text = 'vehicles = ["full_car"]\ncontrollers = ["passive"]\nspeeds = [10.0]\nduration = 0.1\n'
    read_campaign(_file(tmp_path, text + 'roads = ["rig:file=drive.csv", "rig:file=other.csv"]\n'))
    with pytest.raises(InputError, match="are the same; list only one of them"):
        read_campaign(_file(tmp_path, text + 'roads = ["rig:file=drive.csv", "rig:file=drive.csv:time_unit=s"]\n'))


def _file(folder, text):
    path = folder / "campaign.toml"
    path.write_text(text)
    return path


def test_written_down():
    """Description and points make the same rig again, to the last bit; scaled ones are as high as they are said to be."""
    rig = history()
    again = described_road(json.loads(json.dumps(rig.describe())), rig.points)
    assert isinstance(again, Rig)
    assert np.array_equal(again.time, rig.time)
    assert np.array_equal(again.heights, rig.heights)
    assert (again.posts, again.source, again.points) == (rig.posts, rig.source, rig.points)
    t = np.linspace(-1, 3, 50)
    assert np.allclose(rig.scaled(-2.0).displacement(t, "rear_left"), -2 * rig.displacement(t, "rear_left"), rtol=1e-12)
    with pytest.raises(InputError, match=r"does not contain the points of the road .rig."):
        described_road(rig.describe())
    for broken in (b"", rig.points[:200], rig.points.replace(b"front_left", b"front_left,x", 1), rig.points.replace(b",", b";")):
        with pytest.raises(InputError, match=r"rig|columns"):
            described_road(rig.describe(), broken)


GOOD = "time [s],front [mm],rear [mm]\n0,0,0\n1,1,1\n2,2,2\n3,3,3\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (GOOD.replace("rear", "back"), "with this name has no heights; give one of the columns back, front this name"),
        (GOOD.replace("\n", ",0\n").replace("mm],0", "mm],spare [mm]"), "column 'spare' does not belong to a wheel"),
        (GOOD.replace("rear", "Front"), "the columns 'front' and 'Front' belong to the same wheel"),
        (GOOD.replace("front [mm]", "front"), "'front', has no unit (allowed: cm, ft, in, km, m, mm); change the heading to"),
        (GOOD.replace("time [s]", "time"), "column 1, 'time', has no unit (allowed: ms, s); change the heading to time [s]"),
        (GOOD.replace("rear [mm]", "rear [kN]"), "the unit 'kN' (allowed: cm, ft, in, km, m, mm); convert"),
        (GOOD.replace("time", "distance"), "0 columns are called time, but exactly one column of times is needed"),
        (GOOD.replace("front", "t"), "two columns are called 'time'"),
        ("time [s]\n0\n1\n2\n3\n", "the drive file has no columns of heights"),
        (GOOD.replace("2,2,2", "1,2,2"), "time 1 s is repeated (line 3 and line 4); keep only one of the two points"),
        (GOOD.replace("3,3,3", "30,3,3"), "there is a gap from 2 s to 30 s (line 4 and line 5)"),
        (GOOD.replace("3,3,3", "3,3,3000"), "line 5 differs by 3 m from the first height of the same post, but at most 2 m"),
        (GOOD.replace("3,3,3\n", ""), "a time history needs at least 4 points, but this one has 3"),
        (GOOD.splitlines()[0], "no line of numbers; give a line of headings"),
        (GOOD.replace("front", ""), "a column is called ''"),
    ],
)  # fmt: skip
def test_bad_files(text, said, tmp_path, capsys):
    """A file that is no drive file is refused in one line that names it, the line, and what to do."""
    (tmp_path / "drive.csv").write_text(text)
    with refused(said, "drive.csv"):
        main(["--vehicle", "half_car", "--controller", "passive", "--road", f"rig:file={tmp_path}/drive.csv", "--no-logs"])


def test_a_wheel_without_a_post():
    """A vehicle whose wheels have no posts is not driven."""
    with pytest.raises(InputError, match="no column is called rear_left, so the post"):
        history(CORNERS[:2]).check(CAR, sample_times(CAR, 1.0, 1e-3))
    assert track_width(CAR) > 0
    still = replace(history(), heights=np.zeros((200, 4)))
    still.check(CAR, sample_times(CAR, 1.0, 1e-3))
