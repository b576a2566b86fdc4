"""Colours that can be told from their background, whatever a figure asks for: WCAG 2.2, contrast of text and of graphics."""

from models.figures.figure import rgb

TEXT, GRAPHICS = 4.5, 3.0  # least contrasts, success criteria 1.4.3 and 1.4.11
STEPS = 50


def luminance(color: str) -> float:
    """Relative luminance of `#rrggbb`, from 0 for black to 1 for white."""
    parts = [part / 255 for part in rgb(color)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(one: str, other: str) -> float:
    """Between two colours, from 1 for the same to 21 for black and white."""
    low, high = sorted((luminance(one), luminance(other)))
    return (high + 0.05) / (low + 0.05)


def readable(color: str, background: str, least: float = GRAPHICS) -> str:
    """The colour itself where it has that contrast; else mixed with as little white, or black, as gives it."""
    toward = max(("#000000", "#ffffff"), key=lambda end: contrast(end, background))
    mixed = (_mixed(color, toward, step / STEPS) for step in range(STEPS + 1))
    return next((one for one in mixed if contrast(one, background) >= least), toward)


def _mixed(color: str, other: str, share: float) -> str:
    pairs = zip(rgb(color), rgb(other), strict=True)
    return "#" + "".join(f"{round((1 - share) * a + share * b):02x}" for a, b in pairs)
