"""modelDescription.xml of an FMU for FMI 2.0 and 3.0, and buildDescription.xml for FMI 3.0."""

from collections.abc import Mapping, Sequence
from xml.sax.saxutils import quoteattr

from models.kinds.signals import OWN, Signal
from models.laws.python_law import TOOL
from models.vehicle.limits_and_implementation import samples
from synth.controller.export.fmu_model import FmuModel

BASE = {
    "m": {"m": 1},
    "m/s": {"m": 1, "s": -1},
    "m/s2": {"m": 1, "s": -2},
    "m/s3": {"m": 1, "s": -3},
    "rad": {"rad": 1},
    "rad/s": {"rad": 1, "s": -1},
    "rad/s2": {"rad": 1, "s": -2},
    "N": {"kg": 1, "m": 1, "s": -2},
    "N/s": {"kg": 1, "m": 1, "s": -3},
    "N m": {"kg": 1, "m": 2, "s": -2},
    "N s/m": {"kg": 1, "s": -1},
    "s": {"s": 1},
}
RATES = {"m/s": "m/s2", "m/s2": "m/s3", "rad/s": "rad/s2"}
CATEGORIES = ("logStatusWarning", "logStatusDiscard", "logStatusError")
# timestep of a system that has no sample period [s], and number of samples in the default experiment
STEP, SAMPLES = 0.001, 1000
Attributes = Mapping[str, str | float | bool | None]


def description(model: FmuModel, version: int, token: str, files: Sequence[str]) -> str:
    """Returns the text of modelDescription.xml.

    Args:
        model: content of the FMU.
        version: version of FMI, 2 or 3.
        token: GUID (FMI 2) or instantiation token (FMI 3).
        files: names of the C files that are compiled.
    """
    head = {
        "fmiVersion": f"{version}.0",
        "modelName": model.title,
        "guid" if version == 2 else "instantiationToken": token,
        "description": _about(model),
        "generationTool": TOOL,
        "variableNamingConvention": "structured",
    }
    head |= {"numberOfEventIndicators": 0} if version == 2 else {}
    step = STEP if model.period is None else model.period
    lines = ['<?xml version="1.0" encoding="UTF-8"?>', f"<fmiModelDescription{_xml_attributes(head)}>"]
    for kind in ["ModelExchange"] * bool(model.states) + ["CoSimulation"]:
        lines += _interface(model, kind, version, files)
    lines += _units(model)
    lines += [
        "  <LogCategories>",
        *(f"    <Category{_xml_attributes({'name': one})}/>" for one in CATEGORIES),
        "  </LogCategories>",
    ]
    lines.append(f"  <DefaultExperiment{_xml_attributes({'startTime': 0, 'stopTime': SAMPLES * step, 'stepSize': step})}/>")
    computer = f"<Implementation{_xml_attributes({'delay': model.delay})}/>"
    if version == 2 and model.delay:
        lines.append(f'  <VendorAnnotations><Tool name="{TOOL}">{computer}</Tool></VendorAnnotations>')
    lines += ["  <ModelVariables>", *_variables(model, version), "  </ModelVariables>"]
    lines += ["  <ModelStructure>", *_structure(model, version), "  </ModelStructure>"]
    if version == 3 and model.delay:
        lines.append(f'  <Annotations><Annotation type="{TOOL}">{computer}</Annotation></Annotations>')
    return "\n".join([*lines, "</fmiModelDescription>"]) + "\n"


def build_description(model: FmuModel, files: Sequence[str]) -> str:
    """Returns the text of buildDescription.xml for FMI 3. The description contains one set of C99 source files."""
    listed = "".join(f"      <SourceFile{_xml_attributes({'name': name})}/>\n" for name in files)
    return (
        '<?xml version="1.0" encoding="UTF-8"?>\n<fmiBuildDescription fmiVersion="3.0">\n'
        f"  <BuildConfiguration{_xml_attributes({'modelIdentifier': model.identifier})}>\n"
        f'    <SourceFileSet language="C99">\n{listed}    </SourceFileSet>\n  </BuildConfiguration>\n</fmiBuildDescription>\n'
    )


def _about(model: FmuModel) -> str:
    if model.states:
        return f"{model.title}. SI units, from static equilibrium. In co-simulation a step with constant inputs is exact."
    title = f"{model.title}. Outputs are delayed by {samples(model.delay)}" if model.delay else model.title
    if model.period is None:
        return f"{title}. A step computes the outputs from the current inputs, and may have any length."
    return (
        f"{title}. The law is discrete: each step must last {model.period:g} s and computes the outputs from the current "
        f"inputs. "
        "Step this FMU before the vehicle, or its outputs act one period later."
    )


def _xml_attributes(attributes: Attributes) -> str:
    """Returns attributes in XML syntax; attributes that are None are omitted."""
    return "".join(f" {name}={quoteattr(_text(value))}" for name, value in attributes.items() if value is not None)


def _text(value: str | float | bool | None) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    return value if isinstance(value, str) else repr(value)


def _interface(model: FmuModel, kind: str, version: int, files: Sequence[str]) -> list[str]:
    linear, steps, two = bool(model.states), kind == "CoSimulation", version == 2
    attributes: dict[str, str | float | bool | None] = {"modelIdentifier": model.identifier}
    attributes |= {"canNotUseMemoryManagementFunctions": True} if two else {}
    attributes |= {"canGetAndSetFMUstate" if two else "canGetAndSetFMUState": True}
    attributes |= {"canSerializeFMUstate" if two else "canSerializeFMUState": True}
    attributes |= {"providesDirectionalDerivative" if two else "providesDirectionalDerivatives": linear}
    if steps:
        attributes |= {"canHandleVariableCommunicationStepSize": model.period is None}
        attributes |= {} if two else {"fixedInternalStepSize": model.period}
    if not two:
        return [f"  <{kind}{_xml_attributes(attributes)}/>"]
    listed = [f"      <File{_xml_attributes({'name': name})}/>" for name in files]
    return [f"  <{kind}{_xml_attributes(attributes)}>", "    <SourceFiles>", *listed, "    </SourceFiles>", f"  </{kind}>"]


def _units(model: FmuModel) -> list[str]:
    units = {_unit(one) for one in (*model.inputs, *model.outputs, *model.states)}
    units |= {_rate(one) for one in model.states} | {"s"}
    lines = ["  <UnitDefinitions>"]
    for unit in sorted(unit for unit in units if unit is not None):
        base = f"<BaseUnit{_xml_attributes(BASE[unit])}/>" if unit in BASE else ""
        lines.append(f"    <Unit{_xml_attributes({'name': unit})}>{base}</Unit>")
    return [*lines, "  </UnitDefinitions>"]


def _unit(signal: Signal) -> str | None:
    return None if signal.unit == OWN else signal.unit


def _rate(signal: Signal) -> str | None:
    """Returns the unit of the derivative of a state; None if this unit is not known."""
    return None if signal.unit == OWN else RATES.get(signal.unit, f"{signal.unit}/s")


def _variables(model: FmuModel, version: int) -> list[str]:
    """Returns the variables of an FMU in the order of their value references: inputs, outputs, states, derivatives.

    For FMI 3, the last variable is the time, which FMI 3 requires.
    """
    groups: tuple[tuple[Sequence[Signal], str, str, str | None, float | None], ...] = (
        (model.inputs, "input", "continuous", None, 0.0),
        (model.outputs, "output", "continuous" if model.states else "discrete", "calculated", None),
        (model.states, "local", "continuous", "exact", 0.0),
    )
    rows: list[tuple[str, str, Attributes, Attributes]] = []
    for signals, causality, variability, initial, start in groups:
        kind = {"causality": causality, "variability": variability, "initial": initial}
        rows += [(one.name, one.meaning, kind, {"unit": _unit(one), "start": start}) for one in signals]
    kind = {"causality": "local", "variability": "continuous", "initial": "calculated"}
    # FMI 2 numbers variables with an index from 1; FMI 3 uses the value reference
    first = len(model.inputs) + len(model.outputs) + (version == 2)
    for i, one in enumerate(model.states):
        rows.append((f"der({one.name})", f"derivative of {one.name}", kind, {"unit": _rate(one), "derivative": first + i}))
    if version == 3:
        rows.append(("time", "time", {"causality": "independent", "variability": "continuous"}, {"unit": "s"}))
    lines = []
    for i, (name, meaning, kind, number) in enumerate(rows):
        whole = {"name": name, "valueReference": i, "description": meaning, **kind}
        if version == 2:
            lines.append(f"    <ScalarVariable{_xml_attributes(whole)}><Real{_xml_attributes(number)}/></ScalarVariable>")
        else:
            lines.append(f"    <Float64{_xml_attributes({**whole, **number})}/>")
    return lines


def _structure(model: FmuModel, version: int) -> list[str]:
    m, p, n = len(model.inputs), len(model.outputs), len(model.states)
    index = 1 if version == 2 else 0
    known = [*range(m), *range(m + p, m + p + n)]  # value references of the inputs and of the states
    unknown = [*range(m, m + p), *range(m + p + n, m + p + 2 * n)]

    def row(i: int, name: str, kinds: bool = True) -> str:
        of = [] if model.slopes is None else [known[j] + index for j, slope in enumerate(model.slopes[i]) if slope]
        attributes: dict[str, str | float | bool | None] = {("index" if index else "valueReference"): unknown[i] + index}
        attributes |= {"dependencies": " ".join(map(str, of))}
        attributes |= {"dependenciesKind": " ".join(["constant"] * len(of))} if kinds else {}
        return f"<{name}{_xml_attributes(attributes)}/>"

    outputs, derivatives = range(p), range(p, p + n)
    if version == 3:
        lines = [row(i, "Output") for i in outputs] + [row(i, "ContinuousStateDerivative") for i in derivatives]
        return [f"    {line}" for line in [*lines, *(row(i, "InitialUnknown", False) for i in [*outputs, *derivatives])]]
    lines = list[str]()
    for name, some in (("Outputs", outputs), ("Derivatives", derivatives), ("InitialUnknowns", [*outputs, *derivatives])):
        if some:
            inner = [f"      {row(i, 'Unknown', name != 'InitialUnknowns')}" for i in some]
            lines += [f"    <{name}>", *inner, f"    </{name}>"]
    return lines
