"""Layouts for Foxglove and Lichtblick: the car in 3D, all signals in the MuJoCo and sampled responses, and the differences
between both responses.

In Foxglove and in Lichtblick, choose "Import from file..." in the list of layouts. A layout consists of settings of panels,
with keys `TYPE!NAME`, and a tree of rows and columns; see https://docs.foxglove.dev/docs/visualization/layouts.
"""

import json
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from sim.recording.foxglove_scene import WORLD, frame
from sim.recording.mcap_writer import topic
from sim.recording.pages import DIFFERENCE, Curve, Page, Plot, pages
from sim.recording.run_log import RunLog


def write_layout(path: Path, runs: Sequence[RunLog], _metadata: Mapping[str, str]) -> None:
    """Writes the layout of an MCAP file. The metadata of the runs are only in the MCAP file."""
    path.write_text(foxglove_layout(runs), encoding="utf-8", newline="\n")


def foxglove_layout(runs: Sequence[RunLog]) -> str:
    """Returns the layout of an MCAP file as JSON, with a tab for each run.

    If there are several runs, the first tab shows all runs.
    """
    panels: dict[str, Any] = {}
    tabs = [("all", _seen(panels, runs, runs, "all"))] if len(runs) > 1 else []
    tabs += [(run.name, _seen(panels, runs, [run], run.name)) for run in runs]
    root = _tab_panel(panels, "runs", tabs)
    layout = {"configById": panels, "globalVariables": {}, "userNodes": {}, "playbackConfig": {"speed": 0.2}, "layout": root}
    return json.dumps(layout, indent=1)


def _seen(panels: dict[str, Any], runs: Sequence[RunLog], seen: Sequence[RunLog], name: str) -> Any:
    """Adds the panels for one run or for all runs to the layout.

    For a single run, the car and the events are on the left; for all runs, the cars are above the plots.
    """
    car, log = f"3D!{_id(name)}", f"RosOut!{_id(name)}"
    panels[car] = _scene(runs, seen)
    plots = _tab_panel(panels, name, [(page.title, _page(panels, runs, page, name)) for page in pages(runs, seen)])
    if len(seen) > 1:
        return _stack("column", [car, plots], [2.0, 3.0])
    panels[log] = {"searchTerms": [], "minLogLevel": 1, "topicToRender": topic(runs, seen[0], "events")}
    return _stack("row", [_stack("column", [car, log], [3.0, 1.0]), plots], [2.0, 3.0])


def _page(panels: dict[str, Any], runs: Sequence[RunLog], page: Page, name: str) -> Any:
    """Adds the plots of a page in rows, and the plots of differences below the rows."""
    ids = [_plot(panels, runs, plot, f"{name} {page.title} {i}") for i, plot in enumerate(page.plots)]
    rows = [_stack("row", ids[start : start + page.columns]) for start in range(0, len(ids), page.columns)]
    if not page.difference:
        return _stack("column", rows)
    gap = _plot(panels, runs, Plot(DIFFERENCE, page.difference), f"{name} {page.title} difference")
    return _stack("column", [_stack("column", rows), gap], [4.0, 1.0])


def _scene(runs: Sequence[RunLog], seen: Sequence[RunLog]) -> dict[str, Any]:
    """Returns a 3D panel that shows the car from the left, slightly from the front and above. If the panel shows a single car,
    the camera follows it.

    A single vehicle that moves in the roll plane is shown from behind.
    """
    low, high = np.array([run.scene.finite().extent() for run in seen]).swapaxes(0, 1)
    size = (high - low).max(axis=0)
    length = 1.15 * size[0] * len(seen)
    middle = ((low + high) / 2).mean(axis=0)
    visible = {topic(runs, run, name): {"visible": run in seen} for run in runs for name in ("transforms", "shapes", "scene")}
    return {
        "cameraState": {
            "distance": float(1.1 * max(length, 2 * size[2])),
            "perspective": True,
            "phi": 75,  # angle of view in degrees from the vertical
            # Angle in degrees that lets the camera look from behind or from the left
            "thetaOffset": 109 if len(seen) == 1 and seen[0].scene.flat else 204,
            "fovy": 45,
            "near": 0.1,
            "far": 500,
            "target": [0, 0, 0],
            "targetOffset": [float((length - 1.15 * size[0]) / 2 + middle[0]), float(middle[1]), float(middle[2])],
            "targetOrientation": [0, 0, 0, 1],
        },
        "followMode": "follow-pose",
        "followTf": frame(seen[0]) if len(seen) == 1 else WORLD,
        "scene": {"backgroundColor": "#ced6e0", "transforms": {"showLabel": False, "axisScale": 0}},
        "transforms": {},
        "topics": visible,
        "layers": {},
    }


def _plot(panels: dict[str, Any], runs: Sequence[RunLog], plot: Plot, name: str) -> str:
    """Adds a plot of signals over time, or over a field of the messages other than time. Returns its id. All plots over time
    are zoomed together.
    """
    panel = f"Plot!{_id(name)}"
    axis: dict[str, Any] = {"xAxisVal": "timestamp"}
    if plot.diagram is not None:
        over = _field(runs, plot.curves[0], plot.diagram.argument.name)
        axis = {"xAxisVal": "custom", "xAxisPath": {"value": over, "enabled": True}}
    panels[panel] = {
        "title": plot.title,
        "paths": [
            {
                "value": _field(runs, curve, curve.signal),
                "label": curve.label,
                "color": curve.color,
                "lineSize": curve.width,
                "showLine": True,
                "enabled": True,
                "timestampMethod": "receiveTime",
            }
            for curve in plot.curves
        ],
        **axis,
        "isSynced": plot.diagram is None,
        "showLegend": True,
        "legendDisplay": "floating",
        "showPlotValuesInLegend": False,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "sidebarDimension": 240,
    }
    return panel


def _field(runs: Sequence[RunLog], curve: Curve, name: str) -> str:
    """Returns the path of a signal in the topic of a curve, with special characters quoted."""
    path = topic(runs, curve.run, curve.topic)
    plain = re.fullmatch(r"[A-Za-z0-9_/-]+", path)
    return f"{path if plain else json.dumps(path, ensure_ascii=False)}.{name}"


def _tab_panel(panels: dict[str, Any], name: str, pages: list[tuple[str, Any]]) -> Any:
    """Adds a tab panel that contains all pages; if there is a single page, returns this page unchanged."""
    if len(pages) == 1:
        return pages[0][1]
    panel = f"Tab!{_id(name)}"
    panels[panel] = {"activeTabIdx": 0, "tabs": [{"title": title, "layout": layout} for title, layout in pages]}
    return panel


def _stack(direction: str, parts: Sequence[Any], shares: Sequence[float] = ()) -> Any:
    """Returns parts of a layout, arranged in a row or a column, as the binary tree that Foxglove and Lichtblick use."""
    shares = [*shares, *[1.0] * len(parts)][: len(parts)]
    if len(parts) == 1:
        return parts[0]
    return {
        "direction": direction,
        "first": parts[0],
        "second": _stack(direction, parts[1:], shares[1:]),
        "splitPercentage": 100 * shares[0] / sum(shares),
    }


def _id(name: str) -> str:
    """Returns the name that a panel has in its id, with special characters encoded."""
    return re.sub(r"[^A-Za-z0-9]", lambda match: f"_{ord(match.group()):x}", name)
