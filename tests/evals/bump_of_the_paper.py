"""The paper's bump (61)-(62) with its printed gains: peaks that an independent solver of the continuous loop gave."""

from tests.evals import Answer, Case

SIGNALS = ("sprung_acceleration", "suspension_deflection", "tyre_deflection", "control_force")
LAST_DIGITS = (5e-4, 5e-6, 5e-7, 0.05)  # half the unit of the last digit that was written down
PEAKS = {  # by the place of the controller; SI units
    0: (2.324, 83.08e-3, 6.420e-3, 0.0),  # passive
    4: (0.918, 95.37e-3, 6.059e-3, 1223.4),  # state
    5: (0.763, 96.97e-3, 5.996e-3, 1227.8),  # I; Drake's multibody plant agrees
    6: (1.152, 94.03e-3, 6.044e-3, 1106.7),  # II
}
SOURCE = "DOP853 at rtol 1e-12 on the continuous closed loop, 3 s, 1 kHz"

CASES = [
    Case(
        "Which peaks does the car have over the paper's bump?",
        "sim.bump --controller all --no-logs",
        [
            Answer(f"runs.{i}.signals.{signal}.peak.continuous", peak, (half + 1e-12) / (peak or 1), SOURCE)
            for i, peaks in PEAKS.items()
            for signal, half, peak in zip(SIGNALS, LAST_DIGITS, peaks, strict=True)
        ],
    )
]
