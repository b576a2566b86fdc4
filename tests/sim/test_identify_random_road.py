"""Identification from a random road that is not measured: intervals cover, and what spectra do not determine is named.

Signals are sums of sinusoids with normal amplitudes, from the transfer functions of a quarter-car that are written here.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

from models.common.arrays import Array
from models.common.errors import InputError
from models.vehicle.vehicle import read_vehicle
from sim.studies.identification.identification import Identification, identify
from sim.studies.identification.log_map import LogKeys, LogMap, SensorSection

BODY, HUB, TRAVEL = "sprung_acceleration", "unsprung_acceleration", "suspension_deflection"
NOISE = {BODY: 0.05, HUB: 0.5, TRAVEL: 5e-4}  # rms [m/s2, m/s2, m]
P = read_vehicle("quarter_car").parameters
MASS, ROUGHNESS = "sprung_mass", 64e-6  # kg; G_d(n0) of class B [m3]
SPEED, STEP = 15.0, 0.01  # m/s, s


def signals(names: Sequence[str], seed: int, duration: float, waviness: float = 2.0) -> list[Array]:
    """Returns what sensors measure on a stretch of a road that repeats after eight times the duration."""
    random, count = np.random.default_rng(seed), round(duration / STEP)
    f = np.fft.rfftfreq(8 * count, STEP)[1:]
    density = ROUGHNESS * 0.1**waviness * SPEED ** (waviness - 1) * f**-waviness  # of the height, one-sided [m2/Hz]
    # E |a|^2 = 2 density df for the height: the real part of the sum of a exp(2 pi i f t)
    a = np.sqrt(density * f[0]) * (random.standard_normal(len(f)) + 1j * random.standard_normal(len(f)))
    ms, mu, ks, cs, kt = P[MASS], P["unsprung_mass"], P["suspension_stiffness"], P["suspension_damping"], P["tyre_stiffness"]
    s = 2j * np.pi * f
    D = ms * mu * s**4 + (ms + mu) * cs * s**3 + (ms * (ks + kt) + mu * ks) * s**2 + cs * kt * s + ks * kt
    body, hub = kt * (cs * s + ks) / D, kt * (ms * s**2 + cs * s + ks) / D
    responses = {BODY: s**2 * body, HUB: s**2 * hub, TRAVEL: body - hub}
    each = list[Array]()
    for name in names:
        exact = 4 * count * np.fft.irfft(np.concatenate([[0.0], responses[name] * a]), 8 * count)
        each.append(exact[3 * count : 4 * count] + NOISE[name] * random.standard_normal(count))
    return each


def written(path: Path, names: Sequence[str], values: Sequence[Array]) -> Path:
    """Writes a log with these signals; returns its path."""
    units = {BODY: "m/s2", HUB: "m/s2", TRAVEL: "m"}
    head = ",".join(["time [s]", *(f"{name} [{units[name]}]" for name in names)])
    table = np.column_stack([STEP * np.arange(len(values[0])), *values])
    np.savetxt(path, table, fmt="%.9g", delimiter=",", header=head, comments="")
    return path


def identified(
    path: Path,
    names: Sequence[str] = (BODY, TRAVEL),
    seed: int = 0,
    duration: float = 40.0,
    fix: Sequence[str] = (MASS,),
    free: Sequence[str] = (),
    waviness: float = 2.0,
    road: str = "iso8608:class=C",
    late: Mapping[str, int] = {},
) -> Identification:
    """Returns the identification from a log of a road of class B, whose class is given as C: four times too rough.

    Args:
        late: number of samples by which signals are late.
    """
    values = [np.roll(one, late.get(name, 0)) for name, one in zip(names, signals(names, seed, duration, waviness), strict=True)]
    log_map = LogMap(LogKeys(road=road, speed=SPEED), {name: SensorSection() for name in names})
    return identify([written(path / "log.csv", names, values)], read_vehicle("quarter_car"), log_map, fix, free)


def off(of: Identification) -> Array:
    """Returns the error of each free parameter in standard deviations."""
    truth = {**P, "roughness": ROUGHNESS, "waviness": 2.0}
    return np.array([np.log(of.estimate.values[name] / truth[name]) / of.estimate.deviations[name] for name in of.estimate.free])


def test_a_road_that_is_not_measured(tmp_path):
    """Two sensors determine four ratios and the roughness within four standard deviations; the scale of masses is named."""
    of = identified(tmp_path, fix=())
    assert of.estimate.structure.held == (MASS,)
    assert {*of.intervals} == {"roughness"}
    assert of.estimate.ratios["tyre_stiffness"] == {"tyre_stiffness": 1.0, MASS: -1.0}
    assert np.abs(off(of)).max() < 4
    assert max(of.estimate.deviations.values()) < 0.15
    assert of.estimate.noise == pytest.approx(
        {name: NOISE[name] for name in (BODY, TRAVEL)}, rel=0.1
    )  # of 4000 samples, 5 standard deviations
    assert of.estimate.white


def test_what_random_roads_need(tmp_path):
    """A class without a speed, and a log whose second half is three times as fast, are named."""
    values = signals((BODY, TRAVEL), 1, 20.0)
    path = written(tmp_path / "log.csv", (BODY, TRAVEL), values)
    for road in ("iso8608", "sine:frequency=2", "bump"):
        with pytest.raises(InputError, match=f"road = '{road}' needs the speed of the vehicle"):
            identify([path], read_vehicle("quarter_car"), LogMap(LogKeys(road=road)))
    louder = [one * np.where(np.arange(len(one)) < len(one) / 2, 1.0, 3.0) for one in values]
    written(path, (BODY, TRAVEL), louder)
    of = identify([path], read_vehicle("quarter_car"), LogMap(LogKeys(road="iso8608", speed=SPEED)), [MASS])
    assert any("changes by a factor of 3" in one for one in of.remarks)


@pytest.mark.attack
@pytest.mark.parametrize("change", ["delay", "waviness"])
def test_a_wrong_road_or_sensor_fails_the_test(tmp_path, change):
    """A sensor that is 20 ms late, or a waviness of 2.5 instead of 2, are not as expected; with free waviness, it is right."""
    late, waviness = ({TRAVEL: 2}, 2.0) if change == "delay" else ({}, 2.5)
    assert not identified(tmp_path, late=late, waviness=waviness, duration=60.0).estimate.white
    if change == "waviness":
        of = identified(tmp_path, waviness=waviness, duration=60.0, free=["waviness"])
        assert of.estimate.white
        assert of.estimate.values["waviness"] == pytest.approx(2.5, rel=4 * of.estimate.deviations["waviness"])


@pytest.mark.attack
@pytest.mark.parametrize(
    ("names", "free"),
    [((BODY, HUB, TRAVEL), ()), ((BODY, TRAVEL), ("waviness",)), ((BODY,), ())],
    ids=["three", "waviness", "body"],
)
def test_intervals_of_spectra_cover(tmp_path, names, free):
    """Over 60 seeds, 90 to 98 % of the 95 % intervals cover, and errors have zero mean within 3.5 standard deviations."""
    errors, rejected = [], 0
    for seed in range(60):
        of = identified(tmp_path, names, seed, 60.0, free=free)
        errors.append(off(of))
        rejected += not of.estimate.white
    errors = np.array(errors)
    assert rejected <= 2  # one of 1000 is expected
    assert 0.90 < (np.abs(errors) < 1.96).mean() < 0.98
    assert np.abs(errors.mean(axis=0)).max() < 3.5 / np.sqrt(60)
