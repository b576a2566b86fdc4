"""A survey of a street gives the position on the map: distance is the length of the path, in whichever direction it runs."""

import numpy as np
from scipy import linalg

from tests.evals import Answer, Case, equations, table

SPEED = 80 / 3.6  # m/s, at which the IRI is defined


def roughness(distance, height):
    """Returns the IRI [m/km] of Sayers' golden quarter-car, driven over lines between the heights."""
    step = distance[1] - distance[0]
    A, b = equations(1.0, 0.15, 63.3, 6.0, 653.0)  # per sprung mass
    both = np.zeros((6, 6))
    both[:4, :4], both[:4, 4], both[4, 5] = A, b, SPEED  # the road rises on a line between heights
    whole = linalg.expm(both * step / SPEED)
    reached = int(11 / step)  # the model starts on the mean slope of the first 11 m, as in ASTM E1926
    slope = (height[reached] - height[0]) / (distance[reached] - distance[0])
    x, total = np.array([height[0], slope * SPEED, height[0], slope * SPEED]), 0.0
    for road, rise in zip(height[:-1], np.diff(height) / step, strict=True):
        x = whole[:4] @ [*x, road, rise]
        total += abs(x[1] - x[3]) * step / SPEED
    return 1000 * total / (distance[-1] - distance[0])


S = np.arange(0.0, 150.01, 0.25)
Z = 0.004 * np.sin(2 * np.pi * S / 3.7) + 0.006 * np.sin(2 * np.pi * S / 11.3)
LENGTH = Answer("road.length", 150.0, 1e-6, "arc length of a straight path in the plane")
IRI = Answer("iri.iri.road", roughness(S, Z), 0.02, "golden car by a matrix exponential, without the average over 0.25 m")


def survey(heading: str, angle: float) -> str:
    """Returns the file of a path in a direction [rad]."""
    return table(heading, 500e3 + S * np.cos(angle), 4e6 + S * np.sin(angle), 812 + Z)


DRIVE = "sim.drive --controller passive --speed 20 --duration 3 --no-logs --road survey.csv"
CASES = [
    Case("How rough is a street that runs north-east?", DRIVE, [LENGTH, IRI], {"survey.csv": survey("X (m),Y (m),Z (m)", 0.8)}),
    Case("And one that runs west?", DRIVE, [LENGTH, IRI], {"survey.csv": survey("X (m),Y (m),Z (m)", 3.0)}),
    Case(
        "And if its file has no headings?",
        DRIVE,
        files={"survey.csv": survey("", 0.8).lstrip()},
        refused=["survey.csv", "heading"],
    ),
]
