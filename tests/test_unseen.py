"""Plants with states that z does not see, and with nothing to be gained: a certified gain, or a reason that is true."""

import numpy as np
import pytest
from scipy import linalg

from synth.design import Design, state_design, state_path, two_step_design
from synth.errors import DesignError
from synth.lmi import solve_lmi
from synth.norm import gain_at
from synth.output_feedback import l_matrix, nullspace, r_matrix
from synth.plant import GeneralizedPlant
from synth.posed import posed

README = GeneralizedPlant(
    A=np.array([[0.0, 1], [-4, -0.1]]),
    B=np.array([[0.0], [1]]),
    Bw=np.array([[0.0], [1]]),
    C=np.array([[1.0, 0], [0, 0]]),
    D=np.array([[0], [0.1]]),
    Dw=np.zeros((2, 1)),
)


def beside(plant: GeneralizedPlant, A2, A21, B2, Bw2) -> GeneralizedPlant:
    """A plant with states beside it that it drives, as w and u do, and that z does not see."""
    n, k = len(plant.A), len(A2)
    return GeneralizedPlant(
        A=np.block([[plant.A, np.zeros((n, k))], [A21, A2]]),
        B=np.vstack([plant.B, B2]),
        Bw=np.vstack([plant.Bw, Bw2]),
        C=np.hstack([plant.C, np.zeros((len(plant.C), k))]),
        D=plant.D,
        Dw=plant.Dw,
    )


FAMILIES = ("plain", "low-pass", "mixed", "no output", "w apart", "u apart", "free force", "integrator", "copies", "kept out")


def drawn(seed: int) -> tuple[str, GeneralizedPlant, np.ndarray]:
    """A random plant of one of the families, in random coordinates, and what is measured of it."""
    rng = np.random.default_rng([20261121, seed])
    family = FAMILIES[seed % len(FAMILIES)]
    n, m, r, k = (int(rng.integers(1, top)) for top in (5, 3, 3, 3))
    A = rng.standard_normal((n, n))
    A -= (np.linalg.eigvals(A).real.max() - rng.choice([-0.5, 0.3])) * np.eye(n)  # stable or not
    C = np.vstack([rng.standard_normal((2, n)), np.zeros((m, n))])
    D = np.vstack([np.zeros((2, m)), np.eye(m)])
    plant = GeneralizedPlant(
        A, rng.standard_normal((n, m)), rng.standard_normal((n, r)), C, D, rng.choice([0.0, 0.2]) * rng.standard_normal((2 + m, r))
    )
    A2 = rng.standard_normal((k, k))
    A2 -= (np.linalg.eigvals(A2).real.max() + rng.uniform(0.1, 3)) * np.eye(k)
    drives = [rng.choice([0.0, 1.0]) * rng.standard_normal((k, size)) for size in (n, m, r)]
    parts = {name: getattr(plant, name) for name in ("A", "B", "Bw", "C", "D", "Dw")}
    match family:
        case "mixed":  # z sees them unless the force hides them
            parts["D"] = plant.D + np.vstack([rng.standard_normal((2, m)), np.zeros((m, m))])
        case "no output":
            parts["C"] = np.zeros_like(C)
        case "w apart":
            parts["Bw"], parts["Dw"], drives[2] = np.zeros((n, r)), np.zeros((2 + m, r)), rng.standard_normal((k, r))
        case "u apart":
            parts["B"], parts["D"], drives[1] = np.zeros((n, m)), np.zeros((2 + m, m)), rng.standard_normal((k, m))
        case "free force":
            parts["D"] = D * (np.arange(m) > 0)
        case "integrator":
            A2 = np.zeros((k, k)) + np.diag(-rng.uniform(0, 2, k) * (np.arange(k) > 0))
        case "copies":
            A2, drives = plant.A, [np.zeros((n, n)), plant.B, plant.Bw]
        case "kept out":  # z is a force over what would hide the states
            parts["C"], parts["D"] = rng.standard_normal((m, n)), np.eye(m)
            parts["Dw"] = np.zeros((m, r))
    plant = GeneralizedPlant(**parts)
    if family != "plain":
        plant = beside(plant, A2, *drives)
    T = linalg.block_diag(*[np.eye(0)]) if family == "low-pass" else rng.standard_normal((len(plant.A),) * 2)
    if T.size:
        plant = plant.in_coordinates(T)
    return family, plant, rng.standard_normal((int(rng.integers(1, len(plant.A) + 1)), len(plant.A)))
