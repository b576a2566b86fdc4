"""Content of an FMU, either a sampled law as exported C code or a linear system: its variables and its C sources."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from models.common.arrays import Array
from models.kinds.signals import CONTROL_FORCE, DAMPING, Signal
from models.vehicle.vehicle import Vehicle
from synth.controller.export.c_law import ExportedLaw
from synth.controller.export.c_source import CSource, literal
from synth.controller.export.linear_system import signals_of
from synth.plant.state_space import StateSpace

_number = partial(literal, "double")


@dataclass(frozen=True, eq=False)
class FmuModel:
    """Content of an FMU, independent of the version of FMI.

    Attributes:
        identifier: name of the FMU's library; a valid C name.
        title: one-line title.
        inputs: m input signals; their names differ from the names of the outputs.
        outputs: p output signals.
        states: n continuous states, as signals; empty for a sampled law.
        period: length that every simulation step must have [s]; None if steps may have any length.
        delay: delay from the inputs to the outputs [samples]; 0 if the FMU contains a linear system.
        start: outputs before the first step, shape (p,).
        slopes: partial derivatives of outputs and state derivatives with respect to inputs and states, shape (p + n, m + n);
            None for a sampled law. The first p rows belong to the outputs, the other rows to the derivatives of the states. The
            first m columns belong to the inputs, the other columns to the states.
        sources: C files of this model, by file name.
    """

    identifier: str
    title: str
    inputs: tuple[Signal, ...]
    outputs: tuple[Signal, ...]
    states: tuple[Signal, ...]
    period: float | None
    delay: int
    start: Array
    slopes: Array | None
    sources: Mapping[str, str]


def law_model(vehicle: Vehicle, law: ExportedLaw, certificate: str) -> FmuModel:
    """Returns a control law as the content of an FMU for co-simulation.

    Args:
        vehicle: vehicle that the law controls.
        law: exported law. The C prefix of the law must not occur elsewhere in the sources of an FMU.
        certificate: SHA-256 of the certificate file.
    """
    code, m = CSource(law, certificate), len(law.outputs)
    read = zip(law.inputs, law.units, law.meanings, strict=True)
    inputs = [Signal(f"{name}_measured" if name in law.outputs else name, "", unit, meaning) for name, unit, meaning in read]
    meaning = DAMPING.meaning if law.dampers else CONTROL_FORCE.meaning
    outputs = [Signal(name, "", unit, meaning) for name, unit in zip(law.outputs, law.output_units, strict=True)]
    still = np.array([one[0] for one in law.dampers] if law.dampers else np.zeros(m))
    ins = "".join(f"    in.{name} = ({law.numbers})model->values[{i}];\n" for i, name in enumerate(law.inputs))
    outs = "".join(f"    model->values[FMU_INPUTS + {i}] = (double)out.{name};\n" for i, name in enumerate(law.outputs))
    starts = "".join(f"    model->values[FMU_INPUTS + {i}] = {literal('double', value)};\n" for i, value in enumerate(still))
    own = (
        f'#include "fmu.h"\n\nvoid fmu_start(fmu_model *model)\n{{\n    {law.name}_init(&model->law);\n{starts}}}\n\n'
        "void fmu_update(fmu_model *model)\n{\n    (void)model; /* outputs are those of the last step */\n}\n\n"
        f"int fmu_step(fmu_model *model, double step)\n{{\n    {law.name}_in in;\n    {law.name}_out out;\n\n    (void)step;\n"
        f"{ins}    {law.name}_step(&model->law, &in, &out);\n{outs}    return model->law.faults;\n}}\n"
    )
    head = _head(len(inputs), m, 0, f"#define FMU_PERIOD {literal('double', law.period or 0.0)} /* s; 0: any step */\n")
    head = head.replace("\n#endif", f'#include "{law.name}.h"\ntypedef {law.name}_state fmu_law;\n\n#endif')
    sources = {**code.files, "fmu_model.c": own, "fmu_model.h": head}
    title = f"Controller {law.controller} of a {vehicle.kind.name}"
    return FmuModel(law.name, title, tuple(inputs), tuple(outputs), (), law.period, law.delay, still, None, sources)


def linear_model(identifier: str, title: str, vehicle: Vehicle, system: StateSpace) -> FmuModel:
    """Returns the linear system of a vehicle as the content of an FMU for model exchange and co-simulation."""
    n, m, p = len(system.states), len(system.inputs), len(system.outputs)
    slopes = np.block([[system.D, system.C], [system.B, system.A]])
    rate = _number(np.abs(system.A).sum(axis=1).max())
    rows = ",\n    ".join("{" + ", ".join(_number(value) for value in row) + "}" for row in slopes)
    sources = {
        "linear.c": "",
        "fmu_model.c": f'#include "fmu.h"\n\nconst double fmu_slopes[{p + n}][{m + n}] = {{\n    {rows}}};\n',
        "fmu_model.h": _head(m, p, n, f"#define FMU_PERIOD 0.0 /* s; 0: any step */\n#define FMU_RATE {rate} /* 1/s */\n"),
    }
    inputs, states, outputs = (signals_of(vehicle, names) for names in (system.inputs, system.states, system.outputs))
    states = tuple(replace(one, name=f"state.{one.name}") for one in states)
    return FmuModel(identifier, title, inputs, outputs, states, None, 0, np.zeros(p), slopes, sources)


def _head(inputs: int, outputs: int, states: int, more: str) -> str:
    """Returns the text of fmu_model.h. The token in fmu_model.h is inserted later, when all other files are known."""
    return (
        "/* The content of this FMU. */\n#ifndef FMU_MODEL_H\n#define FMU_MODEL_H\n\n"
        f'#define FMU_TOKEN "@TOKEN@"\n#define FMU_INPUTS {inputs}\n#define FMU_OUTPUTS {outputs}\n#define FMU_STATES {states}\n'
        f"{more}\n#endif\n"
    )
