"""Layouts for Foxglove and Lichtblick: the car in 3D, MuJoCo and sampled responses of every signal, and their differences.

In both programs: "Import from file..." in the list of layouts. Format: settings of panels by `TYPE!NAME`, and a tree of rows and
columns; https://docs.foxglove.dev/docs/visualization/layouts.
"""

import json
import re
from collections.abc import Sequence
from typing import Any

import numpy as np

from models.figures.figure import styles, tint
from models.kinds.signals import Signal
from sim.recording.foxglove_scene import WORLD, frame
from sim.recording.mcap_writer import topic
from sim.recording.run_log import DAMPERS, LOADS, PALETTE, RESPONSES, RunLog, compared, groups, plotted, shown, title


def foxglove_layout(runs: Sequence[RunLog]) -> str:
    """Returns the layout of an MCAP file as JSON: for several runs first a tab with all of them, then one for each."""
    panels: dict[str, Any] = {}
    pages = [(run.name, _page(panels, runs, run)) for run in runs]
    root = pages[0][1]
    if len(runs) > 1:
        pages.insert(0, ("all", _comparison(panels, runs)))
        root = "Tab!runs"
        panels[root] = _tabs(pages)
    layout = {"configById": panels, "globalVariables": {}, "userNodes": {}, "playbackConfig": {"speed": 0.2}, "layout": root}
    return json.dumps(layout, indent=1)


def _page(panels: dict[str, Any], runs: Sequence[RunLog], run: RunLog) -> Any:
    """Adds the panels of one run: on the left the car and its events, on the right the responses and the differences."""
    color = styles(tuple(other.name for other in runs))[run.name].color
    car, log = f"3D!{_id(run.name)}", f"RosOut!{_id(run.name)}"
    panels[car] = _scene(runs, [run])
    panels[log] = {"searchTerms": [], "minLogLevel": 1, "topicToRender": topic(runs, run, "events")}
    pages = []
    for group, signals in groups(plotted(run)).items():
        plots = []
        for signal in signals:
            paths = [
                _path(topic(runs, run, name), signal.name, label, tint(color, white), width)
                for name, (label, white, width) in RESPONSES.items()
                if name in run.responses and signal.name in run.responses[name].names
            ]
            plots.append(_plot(panels, f"{run.name} {signal.name}", _title(signal), paths))
        gaps = _difference(panels, runs, run, group, signals)
        pages.append((title(run, group), _stack("column", [_grid(plots, 2 if len(plots) <= 8 else 3), *gaps], [4.0, 1.0])))
    pages += _acting(panels, runs, run, color)
    return _stack("row", [_stack("column", [car, log], [3.0, 1.0]), _paged(panels, run.name, pages)], [2.0, 3.0])


def _acting(panels: dict[str, Any], runs: Sequence[RunLog], run: RunLog, color: str) -> list[tuple[str, Any]]:
    """Adds the panels of loads over time, and of damper and spring forces over their arguments."""
    pages = []
    if LOADS in run.acting:
        where = topic(runs, run, LOADS)
        plots = [
            _plot(panels, f"{run.name} {one.name}", _title(one), [_path(where, one.name, one.name.replace("_", " "), color, 1.5)])
            for one in run.acting[LOADS].signals
        ]
        pages.append(("loads", _grid(plots, 2 if len(plots) > 3 else 1)))
    if DAMPERS in run.acting:
        where, plots = topic(runs, run, DAMPERS), []
        for one in run.diagrams:
            paths = [
                *(_path(where, line.signal.name, line.label, "#111111", line.width) for line in one.lines),
                _path(where, one.pull.name, "MuJoCo", color, 1.5),
            ]
            title = f"{one.title}: force [{one.pull.unit}] over {one.over}"
            plots.append(_plot(panels, f"{run.name} {one.pull.name}", title, paths, _field(where, one.argument.name)))
        pages.append(("dampers and springs", _grid(plots, 2 if len(plots) > 1 else 1)))
    return pages


def _difference(panels: dict[str, Any], runs: Sequence[RunLog], run: RunLog, group: str, signals: Sequence[Signal]) -> list[str]:
    """Adds a plot of MuJoCo minus sampled, if both exist; returns its id in a list."""
    names = [signal.name for signal in signals if run.gap is not None and signal.name in run.gap.names]
    paths = [
        _path(topic(runs, run, "difference"), name, name.replace("_", " "), PALETTE[i % len(PALETTE)], 1.5)
        for i, name in enumerate(names)
    ]
    title = "difference: MuJoCo - sampled, of each signal's peak"
    return [_plot(panels, f"{run.name} difference {group}", title, paths)] if names else []


def _comparison(panels: dict[str, Any], runs: Sequence[RunLog]) -> Any:
    """Adds the panels for all runs: the cars in a row, above plots of every signal."""
    panels["3D!all"] = _scene(runs, runs)
    colours = styles(tuple(run.name for run in runs))
    pages = []
    for group, signals in groups(compared(runs)).items():
        plots = []
        for signal in signals:
            paths = [
                _path(topic(runs, run, shown(run)), signal.name, run.name, colours[run.name].color, 1.5)
                for run in runs
                if signal.name in run.responses[shown(run)].names
            ]
            plots.append(_plot(panels, f"all {signal.name}", _title(signal), paths))
        pages.append((group, _grid(plots, 4)))
    return _stack("column", ["3D!all", _paged(panels, "all", pages)], [2.0, 3.0])


def _scene(runs: Sequence[RunLog], seen: Sequence[RunLog]) -> dict[str, Any]:
    """Returns a 3D panel, seen from the left, slightly from the front and above; a single car is followed."""
    low, high = np.array([run.scene.finite().extent() for run in seen]).swapaxes(0, 1)
    size = (high - low).max(axis=0)
    length = 1.15 * size[0] * len(seen)
    middle = ((low + high) / 2).mean(axis=0)
    visible = {topic(runs, run, name): {"visible": run in seen} for run in runs for name in ("transforms", "shapes", "scene")}
    return {
        "cameraState": {
            "distance": float(1.1 * max(length, 2 * size[2])),
            "perspective": True,
            "phi": 75,  # degrees, from straight above
            "thetaOffset": 204,  # degrees, to the left from behind
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


def _plot(panels: dict[str, Any], name: str, title: str, paths: list[dict[str, Any]], over: str = "") -> str:
    """Adds a plot over time, or over a field; returns its id. Plots over time zoom together."""
    panel = f"Plot!{_id(name)}"
    panels[panel] = {
        "title": title,
        "paths": paths,
        **({"xAxisVal": "custom", "xAxisPath": {"value": over, "enabled": True}} if over else {"xAxisVal": "timestamp"}),
        "isSynced": not over,
        "showLegend": True,
        "legendDisplay": "floating",
        "showPlotValuesInLegend": False,
        "showXAxisLabels": True,
        "showYAxisLabels": True,
        "sidebarDimension": 240,
    }
    return panel


def _path(topic: str, field: str, label: str, color: str, width: float) -> dict[str, Any]:
    """Returns a curve: a field of a topic."""
    return {
        "value": _field(topic, field),
        "label": label,
        "color": color,
        "lineSize": width,
        "showLine": True,
        "enabled": True,
        "timestampMethod": "receiveTime",
    }


def _field(topic: str, field: str) -> str:
    """Returns the path of a field of a topic; special characters are quoted."""
    plain = re.fullmatch(r"[A-Za-z0-9_/-]+", topic)
    return f"{topic if plain else json.dumps(topic, ensure_ascii=False)}.{field}"


def _title(signal: Signal) -> str:
    return f"{signal.name.replace('_', ' ')}   {signal.symbol} [{signal.unit}]"


def _paged(panels: dict[str, Any], name: str, pages: list[tuple[str, Any]]) -> Any:
    """Returns a single page, or a tab panel with several pages."""
    if len(pages) == 1:
        return pages[0][1]
    panel = f"Tab!{_id(name)}"
    panels[panel] = _tabs(pages)
    return panel


def _tabs(pages: list[tuple[str, Any]]) -> dict[str, Any]:
    return {"activeTabIdx": 0, "tabs": [{"title": title, "layout": layout} for title, layout in pages]}


def _grid(panels: list[str], columns: int) -> Any:
    rows = [_stack("row", panels[start : start + columns]) for start in range(0, len(panels), columns)]
    return _stack("column", rows)


def _stack(direction: str, parts: Sequence[Any], shares: Sequence[float] = ()) -> Any:
    """Returns parts in a row or column, as the binary tree of both viewers."""
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
    """Returns a name with special characters encoded, for a panel's id."""
    return re.sub(r"[^A-Za-z0-9]", lambda match: f"_{ord(match.group()):x}", name)
