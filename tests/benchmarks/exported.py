"""Exported code on this machine and on a simulated Cortex-M4: `python -m tests.benchmarks.exported`, in hours on one core.

Random controllers (0 to 12 states, 1 to 4 outputs, delays, limits, quantised readings) and all that a shipped vehicle file has:
every output of the double code is that of Python to the last bit, on both processors. In float and int16 the code's rounding
stays within its bound in the loop. Exit code 1 if anything differs. The extra `[export]` is needed.
"""

import argparse
import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from models.vehicle.vehicle import read_vehicle, shipped
from synth.controller.export import cortex_m4
from synth.controller.export.c_law import ExportedLaw, PythonStep, c_name, exported_law, random_inputs
from synth.controller.export.compiled import ExportedCode
from synth.controller.export.fixed_source import source_of
from synth.vehicle.designer import Designer
from tests.test_code_in_the_loop import KINDS, effects
from tests.test_export import random_law


def shipped_laws() -> Iterator[ExportedLaw]:
    """Yields every shipped controller that can be exported, in double."""
    for name in shipped():
        vehicle = read_vehicle(name)
        designer = Designer(vehicle, search=False)
        for one in vehicle.controllers.values():
            if one.name != "passive":
                driver = designer.design(one.name) if one.name in vehicle.linear_names else one.driver()
                how = vehicle.implementation
                built = replace(vehicle, implementation=replace(how, sample_period=how.sample_period or 0.005))
                yield exported_law(built, driver, "double", c_name(one.name))


def on_this_machine(law: ExportedLaw, rows: Sequence[Sequence[float]]) -> list[list[float]]:
    """Returns the outputs of the code that this machine's compiler makes."""
    source, p, found = source_of(law, "0" * 64), law.name, []
    texts = {f"{p}.h": source.header(), f"{p}.c": source.source(), f"{p}_data.h": source.data()}
    code = ExportedCode(law, texts, "0" * 64).start()
    for row in rows:
        code.seen[:] = row
        code.step()
        found.append(code.given.tolist())
    return found


def differing(law: ExportedLaw, samples: int, elsewhere: int, seed: int) -> tuple[int, int, cortex_m4.ProcessorRun]:
    """Returns the samples in which this machine's code, and the Cortex-M4's in the first `elsewhere`, differ from Python."""
    rows, step = list(random_inputs(law, samples, seed)), PythonStep(law)
    ours = np.array([step(row) for row in rows], dtype=float).view(np.int64)
    here, there = np.array(on_this_machine(law, rows)), cortex_m4.run(law, rows[:elsewhere])
    found = [np.asarray(one, dtype=float).view(np.int64) for one in (here, there.outputs)]
    counts = [int(np.any(one != ours[: len(one)], axis=1).sum()) for one in found]
    return counts[0], counts[1], there


def main(arguments: Sequence[str] | None = None) -> int:
    """Prints a line for each controller, and the verdict; returns the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--controllers", type=int, default=200, help="random controllers (default 200)")
    parser.add_argument("--samples", type=int, default=100_000, help="samples of each (default 100000)")
    parser.add_argument("--elsewhere", type=int, help="samples on the Cortex-M4, which takes a minute for 100000 (default all)")
    options = parser.parse_args(arguments)
    wrong, elsewhere = 0, options.samples if options.elsewhere is None else options.elsewhere
    cortex_m4.COUNTED, cortex_m4.PATIENCE = 5, 0  # without a limit: beside other work a block may take minutes
    vehicles = [read_vehicle(name) for name in KINDS]
    random = (random_law(np.random.default_rng(seed), vehicles[seed % 3], "double") for seed in range(options.controllers))
    for laws in (shipped_laws(), random):
        for seed, law in enumerate(laws):
            here, there, run = differing(law, options.samples, elsewhere, seed)
            shape = f"{law.states:2d} states, {len(law.inputs)} inputs, {len(law.outputs)} outputs, delay {law.delay}"
            counts = f"{run.least} to {run.most} instructions, {run.stack} bytes of stack"
            print(
                f"{law.controller:<14} {shape}: {here} of {options.samples} and {there} of {elsewhere} samples differ; {counts}",
                flush=True,
            )
            wrong += here + there
    for numbers in ("float", "int16"):
        rms, share = effects(numbers, range(options.controllers))
        outside = sum(one >= 1 for one in share)
        print(f"{numbers}: {len(share)} signals, {outside} outside their bound; predicted over observed rms {np.median(rms):.3g}")
        wrong += outside + (not 0.2 < np.median(rms) < 5)
    print("every bit is the same, and every bound holds" if not wrong else f"{wrong} DIFFER")
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
