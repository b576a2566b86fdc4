"""The time of a design against the number of states: both steps and the certificate, on chains of masses, springs and dampers.

    python -m tests.benchmarks.states [--picture FILE.png] [--most STATES]

Every mass rests on its neighbours; the ground under the first moves, a force acts between the first two, and what is measured is
how fast the masses move, and where all but the last are. Chains that are too large for the two steps are designed by descent.
"""

import argparse
import sys
import time

import numpy as np

from models.common.errors import InputError
from synth.design.methods import design as design_for
from synth.design.problem import DesignProblem
from synth.plant.generalized import GeneralizedPlant
from synth.plant.numerics import DesignError

SIZES = (4, 6, 8, 12, 16, 20, 26, 32, 40, 60, 100)
MOST = 60  # by default; 100 take minutes


def chain(states: int) -> tuple[GeneralizedPlant, np.ndarray]:
    """A chain of states / 2 masses of 1 kg, springs of 1 N/m, dampers of 0.3 N s/m, and what is measured of it."""
    k = states // 2
    laplacian = 2 * np.eye(k) - np.eye(k, k=1) - np.eye(k, k=-1)
    laplacian[-1, -1] = 1
    A = np.block([[np.zeros((k, k)), np.eye(k)], [-laplacian, -0.3 * laplacian]])
    B = np.zeros((states, 1))
    B[k : k + 2, 0] = 1, -1
    Bw = np.zeros((states, 1))
    Bw[k, 0] = 1
    C = np.vstack([np.eye(states)[[k - 1]], A[[k]], np.zeros(states)])
    D = np.array([[0.0], [1.0], [0.5]])
    Cy = np.delete(np.eye(states), k - 1, axis=0)
    return GeneralizedPlant(A, B, Bw, C, D, np.zeros((3, 1))), Cy


def main(arguments: list[str]) -> int:
    """Prints the table and the exponent; draws them if asked to."""
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks.states", description="What a design costs against the number of states."
    )
    parser.add_argument("--picture", metavar="FILE", help="draw the costs and the exponent (needs matplotlib)")
    parser.add_argument("--most", type=int, default=MOST, help=f"largest number of states (default: {MOST})")
    options = parser.parse_args(arguments)
    sizes = [size for size in SIZES if size <= options.most]
    if len(sizes) < 3:
        raise InputError(f"--most {options.most} leaves fewer than three sizes; give at least {SIZES[2]}")
    costs, followed = [], []
    for size in sizes:
        plant, Cy = chain(size)
        start = time.process_time()
        try:
            design = design_for(DesignProblem(plant.measured(Cy), alternatives=False))
        except DesignError as error:
            print(f"{size:4d} states: {error}")
            return 1
        costs.append(time.process_time() - start)
        how = "   by descent" if design.instead else ""
        print(f"{size:4d} states {costs[-1]:8.3f} s   norm {design.certificate.norm.value:.6g}{how}", flush=True)
        followed += [] if design.instead else [size]
    large = [i for i, size in enumerate(followed) if size >= 12 or followed[-1] < 20]
    exponent, offset = np.polyfit(np.log(np.array(sizes)[large]), np.log(np.array(costs)[large]), 1)
    print(f"exponent of the two steps {exponent:.2f}")
    if options.picture:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(6, 4), layout="constrained")
        axes = figure.add_subplot(xlabel="states", ylabel="processor time of a design [s]", xscale="log", yscale="log")
        axes.plot(sizes, costs, "o", label="design and certificate")
        line = np.array([sizes[large[0]], followed[-1]])
        axes.plot(line, np.exp(offset) * line**exponent, label=f"two steps: states to the power {exponent:.1f}")
        axes.set_xticks(sizes, [str(size) for size in sizes])
        axes.minorticks_off()
        axes.legend()
        axes.grid(alpha=0.3)
        figure.savefig(options.picture, dpi=150)
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main(sys.argv[1:]))
    except InputError as error:
        print(f"roadproof: {error}", file=sys.stderr)
        sys.exit(2)
