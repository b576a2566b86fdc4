"""The pictures of README.md that no command draws: the animation of a logged run, and the first screen of a report.

    python -m docs.pictures

The animation shows the paper's quarter-car over the paper's bump, without and with controller `I`. All positions and
accelerations come from the log of one run. Heights are drawn twice as large as lengths. The picture of the report needs
Chromium.
"""

import contextlib
import io
import json
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

PICTURES = Path(__file__).parents[1] / ".github" / "pictures"
ANIMATION, REPORT = PICTURES / "bump.webp", PICTURES / "report.png"
CONTROLLERS = {"passive": "Without control", "I": "With controller I"}
COLOURS = {"passive": "#d1495b", "I": "#00798c"}
INK, PAPER, GROUND = "#24292f", "#ffffff", "#c9ccd1"
FRAMES, SLOWER = 75, 2.0  # frames of the animation; how much slower it is than the run
SPEED = 12.5  # of the vehicle [m/s]
HIGHER = 2.0  # scale of heights over that of lengths
RADIUS, LOW, HIGH = 0.34, 1.0, 0.45  # wheel radius, height of the body's underside in equilibrium, its thickness [m]
SEEN = 1.45  # road that is drawn before and behind the wheel [m]

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Motion:
    """A logged run of one controller.

    Attributes:
        time: times [s], shape (T,).
        road: height of the road under the wheel [m], shape (T,).
        wheel: height of the wheel above equilibrium [m], shape (T,).
        body: height of the body above equilibrium [m], shape (T,).
        acceleration: vertical acceleration of the body [m/s2], shape (T,).
        ride: weighted acceleration of the body, rms over the run [m/s2].
        travel: peak of the suspension deflection [m].
    """

    time: Array
    road: Array
    wheel: Array
    body: Array
    acceleration: Array
    ride: float
    travel: float


def simulate(folder: Path) -> dict[str, Motion]:
    """Simulates both controllers over the paper's bump; returns their motions from the log that this writes to a folder."""
    from sim.bump import main

    chosen = [word for name in CONTROLLERS for word in ("--controller", name)]
    with contextlib.redirect_stdout(io.StringIO()) as printed:
        main([*chosen, "--logs", str(folder), "--json"])
    compared = json.loads(printed.getvalue())["compared"]["controllers"]
    (path,) = folder.glob("*.mcap")
    return read_log(path, {row["controller"]: row["ride"] for row in compared})


def read_log(path: Path, rides: Mapping[str, float]) -> dict[str, Motion]:
    """Returns the motion of every controller in a log, by name; `rides` are those that the command printed [m/s2]."""
    from mcap.reader import make_reader
    from mcap_protobuf.decoder import DecoderFactory

    topics = {f"/{name}/mujoco": name for name in CONTROLLERS}
    rows: dict[str, list[Any]] = {name: [] for name in CONTROLLERS}
    with path.open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages(topics=[*topics]):
            rows[topics[channel.topic]].append((message.log_time * 1e-9, decoded))
    return {name: _motion(some, rides[name]) for name, some in rows.items()}


def _motion(rows: list[Any], ride: float) -> Motion:
    def signal(name: str) -> Array:
        return np.array([getattr(decoded, name) for _, decoded in rows])

    road, travel = signal("road_displacement"), signal("suspension_deflection")
    wheel = road + signal("tyre_deflection")
    time = np.array([one for one, _ in rows])
    return Motion(time - time[0], road, wheel, wheel + travel, signal("sprung_acceleration"), ride, float(abs(travel).max()))


class Drawing:
    """The figure of the animation. `at` draws one of its frames."""

    def __init__(self, motions: Mapping[str, Motion]) -> None:
        """Draws the first frame."""
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        self._motions = motions
        self._figure = Figure(figsize=(8.0, 4.5), dpi=100, facecolor=PAPER)
        self._canvas = FigureCanvasAgg(self._figure)
        self._cars = {name: self._car(i, name) for i, name in enumerate(motions)}
        self._curves = self._plot()

    def _car(self, place: int, name: str) -> dict[str, Any]:
        from matplotlib.patches import Circle, FancyBboxPatch

        motion, passive = self._motions[name], self._motions["passive"]
        axes = self._figure.add_axes(
            (0.01 + 0.5 * place, 0.36, 0.48, 0.63), xlim=(-SEEN, SEEN), ylim=(-0.13, 2.15), aspect="equal"
        )
        axes.set_axis_off()
        colour = COLOURS[name]
        said = f"ride {motion.ride:.3f} m/s², travel {1e3 * motion.travel:.0f} mm"
        if name != "passive":
            changes = [100 * (motion.ride / passive.ride - 1), 100 * (motion.travel / passive.travel - 1)]
            said = f"ride {changes[0]:+.0f} %, travel {changes[1]:+.0f} %".replace("-", "\N{MINUS SIGN}")
        axes.text(0, 2.14, CONTROLLERS[name], ha="center", va="top", fontsize=17, color=colour, weight="bold")
        axes.text(0, 1.9, said, ha="center", va="top", fontsize=15, color=INK)
        axes.axhline(LOW, color=GROUND, linestyle=(0, (4, 4)), linewidth=1)
        body = FancyBboxPatch((-0.85, LOW), 1.7, HIGH, boxstyle="round,pad=0,rounding_size=0.12", facecolor=colour, edgecolor=INK)
        wheel = Circle((0, RADIUS), RADIUS, facecolor="#3b4048", edgecolor=INK)
        rim = Circle((0, RADIUS), 0.19, facecolor="#d7dade", edgecolor=INK)
        (spring,) = axes.plot([], [], color=INK, linewidth=2)
        (ground,) = axes.plot([], [], color=INK, linewidth=1.5)
        (rod,) = axes.plot([], [], color=INK, linewidth=2)
        (damper,) = axes.plot([], [], color=INK, linewidth=9, solid_capstyle="butt")
        for patch in (wheel, rim, body):
            axes.add_patch(patch)
        lines = {"spring": spring, "rod": rod, "damper": damper, "ground": ground}
        return {"axes": axes, "body": body, "wheel": wheel, "rim": rim} | lines

    def _plot(self) -> dict[str, Any]:
        axes = self._figure.add_axes((0.11, 0.145, 0.86, 0.2))
        largest = max(abs(one.acceleration).max() for one in self._motions.values())
        axes.set(xlim=(0, self._motions["passive"].time[-1]), ylim=(-1.1 * largest, 1.1 * largest))
        axes.set_xlabel("time [s]", fontsize=13, color=INK, labelpad=1)
        axes.set_ylabel("body [m/s²]", fontsize=11, color=INK)
        axes.tick_params(labelsize=12, colors=INK)
        axes.grid(color="#e3e5e8")
        styles = {"passive": "--", "I": "-"}
        return {name: axes.plot([], [], color=COLOURS[name], linestyle=styles[name], linewidth=2)[0] for name in self._motions}

    def at(self, time: float) -> Any:
        """Returns the frame at a time [s], as an RGB image of Pillow."""
        from PIL import Image

        for name, motion in self._motions.items():
            self._move(self._cars[name], motion, time)
            shown = motion.time <= time
            self._curves[name].set_data(motion.time[shown], motion.acceleration[shown])
        self._canvas.draw()
        return Image.fromarray(np.asarray(self._canvas.buffer_rgba())[..., :3].copy())

    def _move(self, car: Mapping[str, Any], motion: Motion, time: float) -> None:
        along = np.linspace(-SEEN, SEEN, 121)
        road = HIGHER * np.interp(time + along / SPEED, motion.time, motion.road, left=0.0, right=0.0)
        wheel, body = (HIGHER * float(np.interp(time, motion.time, one)) for one in (motion.wheel, motion.body))
        for old in car["axes"].collections:
            old.remove()
        car["axes"].fill_between(along, road, -1, color=GROUND, linewidth=0)
        car["ground"].set_data(along, road)
        car["wheel"].center = car["rim"].center = (0, RADIUS + wheel)
        car["body"].set_y(LOW + body)
        hub, under = RADIUS + wheel, LOW + body
        shares = np.array([0, 0.15, *np.linspace(0.2, 0.8, 9), 0.85, 1])
        aside = np.array([0, 0, *(0.07 * (-1) ** np.arange(9)), 0, 0])
        car["spring"].set_data(0.12 + aside, hub + (under - hub) * shares)
        car["rod"].set_data([-0.12, -0.12], [hub, under])
        car["damper"].set_data([-0.12, -0.12], [hub, hub + 0.32])


def frame_time(frame: int, motion: Motion) -> float:
    """Returns the time of a frame in the run [s]."""
    return float(motion.time[-1]) * frame / (FRAMES - 1)


def animate(motions: Mapping[str, Motion], path: Path = ANIMATION) -> None:
    """Writes the animation as WebP."""
    drawing, passive = Drawing(motions), motions["passive"]
    first, *rest = [drawing.at(frame_time(i, passive)) for i in range(FRAMES)]
    each = round(1e3 * SLOWER * float(passive.time[-1]) / FRAMES)  # ms
    durations = [each] * (FRAMES - 1) + [1500]  # the last frame stays
    first.save(path, save_all=True, append_images=rest, duration=durations, loop=0, quality=70, method=4)


def photograph_report(folder: Path, path: Path = REPORT) -> None:
    """Writes the first screen of a report as PNG."""
    from sim.report.__main__ import main

    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        raise SystemExit("the picture of a report needs Chromium, which is not installed")
    page = folder / "report.html"
    with contextlib.redirect_stdout(io.StringIO()):
        main(["--quick", "--out", str(page), "--controller", "I", "--controller", "II"])
    size = ["--window-size=1000,850", "--hide-scrollbars", "--force-device-scale-factor=1"]
    subprocess.run(
        [browser, "--headless", "--no-sandbox", *size, f"--screenshot={path}", page.as_uri()], check=True, capture_output=True
    )


if __name__ == "__main__":
    with tempfile.TemporaryDirectory() as folder:
        animate(simulate(Path(folder)))
        photograph_report(Path(folder))
