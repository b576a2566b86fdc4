"""The energy balance of a run, in words and numbers."""

from dataclasses import asdict

from models.common.numbers import finite
from sim.physics.energy import BALANCED, Energy
from sim.runs.run import Run


def energy_object(energy: Energy) -> dict[str, float | bool | None]:
    """An energy balance as JSON has it [J]; its residual is a share of `turnover`."""
    numbers = {
        name: finite(value) for name, value in asdict(energy).items() if name not in ("least", "loads") or value is not None
    }
    return numbers | {"balances": energy.balances}


def energy_lines(run: Run) -> list[str]:
    """A run's energy balance in a sentence; none where it is not known."""
    energy = run.energy
    if energy is None:
        return []
    of = f"{energy.residual:.1e} of the {energy.turnover:.4g} J turned over"
    if energy.least is not None and energy.least < 0 and not energy.balances:
        return [f"energy DOES NOT BALANCE: an adjustable damper gave energy, {-energy.least:.1e} of the most that it took"]
    if energy.balances:
        sources = "road and actuators" if energy.loads is None else "road, loads and actuators"
        return [f"energy balances: the work of {sources} is stored or dissipated, all but {of}"]
    why = "a force does work that is none of the vehicle's, or the timestep is too coarse"
    return [f"energy DOES NOT BALANCE: {of} is neither stored nor dissipated, where {BALANCED:.0e} is allowed: {why}"]
