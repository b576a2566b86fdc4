"""`python -m synth`: the design table of a vehicle file, with a lower bound that says how good every controller is."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from models.arrays import Array
from models.command import Parser, run_command
from models.errors import InputError
from models.vehicle import Vehicle, read_vehicle
from synth.central import CentralPoint
from synth.controller import Controller, Designer
from synth.errors import DesignError
from synth.limit import invariant_limit
from synth.lower_bound import lower_bound
from synth.output_feedback import nullspace, output_feedback
from synth.refine import refine
from synth.riccati import proved
from synth.state_feedback import state_feedback

BOUND_AT = 1e-5  # where on the path the lower bound is taken; it is (2 n + d) / 2 times this below the optimum
FLAT_AT = 1e-4  # of gamma: how far the gains may move for it is printed

EPILOG = """
exit code: 0 every claim holds, 1 a controller could not be designed or a claim fails, 2 bad input

examples:
  python -m synth
  python -m synth --controller I --refine --save my_car.toml
  python -m synth --vehicle my_car.toml --check
  python -m synth --controller II --zero-l
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the command; returns its exit code.

    Raises:
        InputError: bad options or vehicle file.
    """
    options = _parser().parse_args(arguments)
    vehicle = read_vehicle(options.check or options.vehicle)
    if options.check and not [entry for entry in vehicle.controllers.values() if entry.gain is not None]:
        raise InputError(f"{options.check} holds no controller with a gain to check; write one with --save")
    designer = Designer(vehicle)
    names = _names(vehicle, options)
    limit, at = invariant_limit(designer.plant)
    best = max(limit, lower_bound(designer.plant, state_feedback(designer.plant, BOUND_AT)[-1]).gamma)
    rows, failures, controllers = [], 0, []
    for name in names:
        try:
            controller, note = _designed(designer, name, options)
        except DesignError as error:
            failures += 1
            rows.append({"name": name, "reason": str(error)})
            continue
        controllers.append(controller)
        failures += bool(controller.certificate.failures)
        rows.append(_row(controller, best, note))
    if options.save:
        _save(options.save, vehicle, controllers)
    if options.json:
        print(json.dumps({"vehicle": vehicle.kind.name, "controllers": rows, "invariant_limit": limit, "at": at}))
    else:
        lines = [f"{vehicle.kind.name} ({vehicle.source})", ""]
        for row in rows:
            lines += _lines(row)
        lines += _flat(designer, vehicle) if not options.check else []
        lines.append(f"no control force changes {limit:.7g} at {at:.5g} rad/s: there z answers to the road alone")
        print("\n".join(lines))
    return 1 if failures else 0


def _parser() -> Parser:
    parser = Parser("synth", "Designs the controllers of a vehicle file and says how good they are.", EPILOG)
    parser.add_argument(
        "--controller", action="append", metavar="NAME", help="one of the vehicle file's; may be repeated (default: all)"
    )
    parser.add_argument(
        "--vehicle", default="quarter_car", metavar="FILE", help="vehicle file, or one that ships (default: quarter_car)"
    )
    parser.add_argument("--zero-l", action="store_true", help="L = 0 instead of equation (14), the one-step design of remark 4")
    parser.add_argument("--refine", action="store_true", help="then lower the norm itself, as far as it is worth a larger gain")
    parser.add_argument("--save", type=Path, metavar="FILE", help="write the vehicle file with the gains added as NAME_designed")
    parser.add_argument("--check", type=Path, metavar="FILE", help="verify the gains of a vehicle file; nothing is designed")
    parser.add_argument("--json", action="store_true", help="print one JSON object and nothing else")
    return parser


def _names(vehicle: Vehicle, options) -> list[str]:
    """The controllers asked for, each once."""
    known = [name for name, entry in vehicle.controllers.items() if entry.gain is not None]
    everything = known if options.check else [name for name in vehicle.controller_names if name != "passive"]
    names = list(dict.fromkeys(options.controller or everything))
    if options.zero_l:
        names = [name for name in names if name in vehicle.controllers and vehicle.controllers[name].gain is None]
        if not names:
            raise InputError("--zero-l needs a controller that is designed from measurements; give one with --controller")
    return names


def _designed(designer: Designer, name: str, options) -> tuple[Controller, str | None]:
    """A controller, and what was traded for its gain."""
    model = designer.vehicle.linear_model
    if options.zero_l:
        measured = designer.vehicle.controllers[name].measured if name in designer.vehicle.controllers else ()
        Cy, _ = model.rows(measured)
        Q = nullspace(Cy)
        point: CentralPoint = output_feedback(designer.plant, Cy, np.zeros((Q.shape[1], len(Cy))), Q)[-1]
        controller = Controller(name, measured, point.K, True, proved(designer.plant, point.K @ Cy))
    else:
        controller = designer.design(name)
    if not controller.designed and controller.measured:
        Cy, _ = model.rows(controller.measured)
        certificate = proved(designer.plant, controller.gain @ Cy)
        controller = Controller(name, controller.measured, controller.gain, False, certificate)
    if not options.refine or not controller.measured or not controller.certificate.stable:
        return controller, None
    Cy, _ = model.rows(controller.measured) if name != "state" else (np.eye(len(model.states)), None)
    refined = refine(designer.plant, Cy, controller.gain)
    certificate = proved(designer.plant, refined.gain @ Cy)
    return Controller(name, controller.measured, refined.gain, True, certificate), refined.traded


def _row(controller: Controller, best: float, note: str | None) -> dict[str, Any]:
    """A controller as JSON has it."""
    certificate = controller.certificate
    norm = certificate.norm
    finite = bool(np.isfinite(norm.value))
    return {
        "name": controller.name,
        "measured": list(controller.measured),
        "gain": controller.gain.tolist(),
        "bound": certificate.bound,
        "norm": norm.value if finite else None,
        "routes_gap": norm.gap if finite else None,
        "peak_frequency": norm.peak_frequency if np.isfinite(norm.peak_frequency) else None,
        "poles": [[float(pole.real), float(pole.imag)] for pole in certificate.poles],
        "lower_bound": best,
        "gap": norm.value / best - 1 if finite and best > 0 else None,
        "traded": note,
        "failures": list(certificate.failures),
    }


def _lines(row: dict[str, Any]) -> list[str]:
    """A controller in the table."""
    if "reason" in row:
        return [f"controller {row['name']}: NOT DESIGNED", f"  {row['reason']}", ""]
    gain = "[" + ", ".join("[" + ", ".join(f"{entry:.6g}" for entry in line) + "]" for line in row["gain"]) + "]"
    lines = [f"controller {row['name']}: measures {', '.join(row['measured']) or 'nothing'}", f"  gain {gain}"]
    if row["norm"] is not None:
        bound = f"bound {row['bound']:.7g}   " if row["bound"] is not None else ""
        where = f" at {row['peak_frequency']:.5g} rad/s" if row["peak_frequency"] is not None else ""
        lines.append(f"  {bound}norm {row['norm']:.7g}{where}   two routes agree to {row['routes_gap']:.0e}")
    if row["gap"] is not None:
        lines.append(f"  within {100 * row['gap']:.2g} % of {row['lower_bound']:.6g}, which no controller can beat")
    lines.append("  poles " + "  ".join(_pole(*pole) for pole in row["poles"]))
    if row["traded"]:
        lines.append(f"  refined: {row['traded']}")
    return [*lines, *(f"  FAILS: {failure}" for failure in row["failures"]), ""]


def _pole(real: float, imaginary: float) -> str:
    return f"{real:.4g}{imaginary:+.4g}j" if imaginary else f"{real:.4g}"


def _flat(designer: Designer, vehicle: Vehicle) -> list[str]:
    """How far the state-feedback gain moves along the path while gamma changes by FLAT_AT."""
    best = designer.state_feedback
    mu, point = 1e-6, best
    while mu < 1:
        candidate = state_feedback(designer.plant, mu)[-1]
        if candidate.gamma > best.gamma * (1 + FLAT_AT):
            break
        mu, point = 2 * mu, candidate
    moved: Array = np.abs(point.K - best.K).max(axis=0)
    largest = np.abs(best.K).max(axis=0)
    parts = ", ".join(
        f"{state} by {distance:.3g} of {size:.4g}"
        for state, distance, size in zip(vehicle.linear_model.states, moved, largest, strict=True)
    )
    return [f"the optimum is flat: for {FLAT_AT:g} of gamma the state gains move, {parts}"]


def _save(path: Path, vehicle: Vehicle, controllers: Sequence[Controller]) -> None:
    """The vehicle file with the gains as controller entries."""
    text = vehicle.text.rstrip("\n") + "\n"
    for controller in controllers:
        if not controller.measured or not controller.designed:
            continue
        gain = [[float(entry) for entry in row] for row in controller.gain]
        text += f"\n[controllers.{controller.name}_designed]  # norm {controller.certificate.norm.value:.10g}\n"
        text += f"measured = {json.dumps(list(controller.measured))}\ngain = {json.dumps(gain)}\n"
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror}); give another --save FILE") from error


if __name__ == "__main__":
    run_command(main)
