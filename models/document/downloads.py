"""Figures as files within a page: each as CSV and as SVG, in `data:` addresses that need neither network nor script."""

import re
from urllib.parse import quote

import numpy as np

from models.document.axis import area_of
from models.document.figure import Bars, Classes, Figure, Panel, Shades
from models.document.reading import as_csv
from models.document.svg import DASHES, HEIGHT, MARKERS, WIDTH, Entry, drawn_text, kept_points, legend, svg

FORM = ".5g"  # of the numbers: more than is seen
LINE, CHAR = 20, 6.6  # height of a line, mean width of a letter [units]
SHEET = """text{font:12.5px Helvetica,Arial,sans-serif;fill:#1c1c1c}.head{font-weight:bold}
path{fill:none}.area{fill:none;stroke:#c8c8c8}.grid{stroke:#dedede}.tick{stroke:#1c1c1c}.point{fill:none;stroke-linecap:round}
.line{stroke-linejoin:round}.bars .point{fill:#ffffff}"""


def csv_link(text: str) -> str:
    """Returns the address of a table that is within the page."""
    return f"data:text/csv;charset=utf-8,{quote(text, safe=SAFE)}"


SAFE = " !$*+,-./;=?@_~|[]{}^`"  # letters that an attribute may have as they are


def downloads(figure: Figure) -> list[tuple[str, str]]:
    """Returns the name of each file of a figure, and its address."""
    return [
        (f"{figure.name}.csv", csv_link(figure_csv(figure))),
        (f"{figure.name}.svg", f"data:image/svg+xml;charset=utf-8,{quote(figure_svg(figure), safe=SAFE)}"),
    ]


def figure_csv(figure: Figure) -> str:
    """Returns the numbers of a figure as CSV: two columns for every curve, three for every area, with their units."""
    columns: list[tuple[str, list[str]]] = []
    for k, panel in enumerate(figure.panels):
        where = (panel.title.partition("\n")[0] or panel.ylabel or f"panel {k + 1}").strip()
        columns += _ground_columns(panel, where)
        area = area_of(panel, WIDTH, HEIGHT)
        for curve in panel.curves:
            name, x, y = curve.name or curve.label, np.asarray(curve.x, float), np.asarray(curve.y, float)
            if not len(x) or not name:
                continue
            if curve.dash != "none":
                kept = kept_points(area.across(x), np.clip(area.down(y), -1e4, 1e4))
                x, y = x[kept], y[kept]
            for label, values in ((panel.xlabel, x), (panel.ylabel or "row", y)):
                columns.append((f"{where} | {name} | {label}", [f"{value:{FORM}}" for value in values.tolist()]))
    longest = max((len(cells) for _, cells in columns), default=0)
    padded = [[*cells, *[""] * (longest - len(cells))] for _, cells in columns]
    return as_csv([title for title, _ in columns], zip(*padded, strict=True))


def _ground_columns(panel: Panel, where: str) -> list[tuple[str, list[str]]]:
    ground = panel.ground
    if isinstance(ground, Bars):
        values = [f"{value:{FORM}}" if np.isfinite(value) else "" for value in ground.values.tolist()]
        return [
            (f"{where} | name", list(ground.names)),
            (f"{where} | {panel.xlabel}", values),
            (f"{where} | text", list(ground.words)),
        ]
    if isinstance(ground, Classes | Shades):
        x, y = (values.ravel().tolist() for values in np.meshgrid(ground.x, ground.y))
        if isinstance(ground, Classes):
            label, cells = "class", [ground.names[kind] for kind in ground.kind.ravel().tolist()]
        else:
            label, cells = ground.label, [f"{value:{FORM}}" for value in ground.z.ravel().tolist()]
        pairs = ((panel.xlabel, x), (panel.ylabel, y))
        return [(f"{where} | {name}", [f"{value:{FORM}}" for value in values]) for name, values in pairs] + [
            (f"{where} | {label}", cells)
        ]
    return []


def figure_svg(figure: Figure) -> str:
    """Returns a figure as one SVG document with its title, legend and all panels."""
    drawn = [svg(panel, f"{figure.name}-{k}") for k, panel in enumerate(figure.panels)]
    sizes = [tuple(map(int, re.findall(r'viewBox="0 0 (\d+) (\d+)"', one)[0])) for one in drawn]
    wide, high = max(width for width, _ in sizes), max(height for _, height in sizes)
    columns = min(figure.columns, len(drawn))
    whole = wide * columns
    parts, top, left = [], 18.0, 4.0
    for text, kind in ((figure.finding, ' class="head"'), (figure.title, "")):
        for line in wrapped(text, int(whole / CHAR)):
            parts.append(f'<text x="4" y="{top:g}"{kind}>{drawn_text(line)}</text>')
            top += LINE * 0.85
    for entry in legend(figure):
        across = 44 + CHAR * 1.15 * len(entry.label)
        if left > 4 and left + across > whole:
            left, top = 4.0, top + LINE
        parts.append(
            f'<g transform="translate({left:g} {top:g})">{_key(entry)}<text x="38" y="4">{drawn_text(entry.label)}</text></g>'
        )
        left += across
    top += LINE * 0.7
    heads = [panel.title.split("\n") if panel.title else [] for panel in figure.panels]
    for k, (one, head) in enumerate(zip(drawn, heads, strict=True)):
        if k % columns == 0 and k:
            top += high
        if k % columns == 0:
            row = heads[k : k + columns]
            lines = max(sum(len(wrapped(text, int(wide / CHAR))) for text in each) for each in row)
            top += LINE * 0.85 * lines + 4
        x = wide * (k % columns)
        texts = [(text, i == 0) for i, part in enumerate(head) for text in wrapped(part, int(wide / CHAR))]
        for i, (text, bold) in enumerate(texts):
            y = top - LINE * 0.85 * (len(texts) - i) + 8
            parts.append(
                f'<text x="{x + 2:g}" y="{y:g}"{" class=" + chr(34) + "head" + chr(34) if bold else ""}>{drawn_text(text)}</text>'
            )
        width, height = sizes[k]
        one = re.sub(r' (?:role|aria-labelledby|data-[a-z]+|id)="[^"]*"', "", one)
        one = re.sub(r"<title.*?</desc>", "", one, flags=re.S)
        parts.append(one.replace("<svg ", f'<svg x="{x:g}" y="{top:g}" width="{width}" height="{height}" ', 1))
    strokes = {curve.color for panel in figure.panels for curve in panel.curves} | {entry.color for entry in legend(figure)}
    fills = set(re.findall(r'class="[^"]*\b[fg]-([0-9a-f]{6})', "".join(parts)))
    sheet = SHEET + "".join(f".s-{color[1:]}{{stroke:{color}}}.full.s-{color[1:]}{{fill:{color}}}" for color in sorted(strokes))
    sheet += "".join(f".f-{color},.g-{color}{{fill:#{color}}}" for color in sorted(fills))
    bottom = top + high
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {whole:g} {bottom:g}" width="{whole:g}" height="{bottom:g}">'
        f"<style>{sheet}</style>"
        f'<rect width="100%" height="100%" fill="#ffffff"/>{"".join(parts)}</svg>'
    )


def _key(entry: Entry) -> str:
    color = entry.color[1:]
    parts = []
    if entry.dash != "none":
        dashes = " ".join(f"{part:g}" for part in DASHES[entry.dash])
        parts.append(
            f'<path class="s-{color}" d="M0 0H34" stroke-width="{entry.width:g}" stroke-dasharray="{dashes or "none"}"/>'
        )
    if entry.marker:
        kind = "point full" if entry.filled else "point"
        path = f'd="M0 0{MARKERS[entry.marker]}"/>'
        parts.append(f'<path class="{kind} s-{color}" transform="translate(17 0) scale(.011)" stroke-width="140" {path}')
    elif entry.dash == "none":
        parts.append(f'<rect class="g-{color}" x="9" y="-6" width="16" height="12" stroke="#777777"/>')
    return "".join(parts)


def wrapped(text: str, letters: int) -> list[str]:
    """Returns a text as lines of at most this many letters; longer words have a line of their own."""
    lines = [""]
    for part in text.split("\n"):
        for word in part.split():
            longer = f"{lines[-1]} {word}".strip()
            if len(longer) > letters and lines[-1]:
                lines.append(word)
            else:
                lines[-1] = longer
    return [line for line in lines if line]
