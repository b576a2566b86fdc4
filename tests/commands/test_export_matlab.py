"""Controllers for MATLAB: the file has the matrices, names, units and certificates, and its loop has the certified norm."""

import numpy as np
import pytest
from scipy.io import loadmat

from models.vehicle.vehicle import parse_vehicle, read_vehicle
from synth.__main__ import main
from synth.controller.export.matlab import RESERVED_WORDS, mat_file
from synth.vehicle.designer import Designer
from tests.commands.test_export import BUILT, LAW
from tests.support.commands import prose

LIMITS = "\n[limits]\nactuator_force = 500.0\n"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Returns the folder with a vehicle file of several laws, and with what is exported of it."""
    folder = tmp_path_factory.mktemp("matlab")
    named = LAW.replace("controllers.law", 'controllers."end"')
    (folder / "car.toml").write_text(read_vehicle("quarter_car").text + LAW + named + BUILT + LIMITS)
    assert main(["--vehicle", str(folder / "car.toml"), "--export", str(folder / "all.mat")]) == 0
    assert main(["--vehicle", str(folder / "car.toml"), "--controller", "law", "--export", str(folder / "one.MAT")]) == 0
    return folder


def test_the_loop_of_the_file_has_the_certified_norm(folder):
    """From the file alone, by scipy: plant and gain closed at the peak's frequency amplify the road by the certificate's norm."""
    content = loadmat(folder / "all.mat", simplify_cells=True)
    vehicle, model, one = read_vehicle("quarter_car"), content["vehicle"]["model"], content["I"]
    s = 1j * one["certificate"]["peak_frequency"]
    G = model["C"] @ np.linalg.solve(s * np.eye(4) - model["A"], model["B"]) + model["D"]
    read = [list(model["outputs"]).index(name) for name in one["inputs"]]
    road, force = (list(model["inputs"]).index(name) for name in ("road_velocity", "control_force"))
    K = np.atleast_2d(one["gain"])
    u = np.linalg.solve(np.eye(1) - K @ G[np.ix_(read, [force])], K @ G[read, road])
    signals = dict(zip(model["outputs"], G[:, road] + G[:, force] * u, strict=True)) | {"control_force": u[0]}
    z = [weight * signals[name] for name, weight in vehicle.performance.items()]
    assert np.linalg.norm(z) == pytest.approx(one["certificate"]["norm"], rel=1e-9)  # rounding of a solve
    assert one["certificate"]["norm"] <= one["certificate"]["bound"]
    assert list(one["inputs_units"]) == ["m", "m/s"]
    assert model["inputs_units"][force] == "N"


def test_a_law_comes_back(folder):
    """A law with states, its period and the matrices that its computer runs come back to the last bit, into Roadproof too."""
    vehicle = parse_vehicle((folder / "car.toml").read_text())
    law = vehicle.controllers["law"].law
    assert law is not None
    struct = loadmat(folder / "all.mat", simplify_cells=True)["law"]
    for name in "ABCD":
        assert np.array_equal(struct[name].reshape(getattr(law, name).shape), getattr(law, name))
        assert np.array_equal(struct["sampled"][name].reshape(getattr(law, name).shape), getattr(law.sampled(0.005), name))
    assert struct["Ts"] == struct["sampled"]["Ts"] == 0.005
    assert struct["anti_windup"] == 5.0
    again = (
        '\n[controllers.again]\nmeasured = ["suspension_deflection", "sprung_velocity"]\nfile = "one.MAT"\nanti_windup = 5.0\n'
    )
    (folder / "again.toml").write_text((folder / "car.toml").read_text() + again)
    back = read_vehicle(str(folder / "again.toml")).controllers["again"].law
    assert back is not None
    assert back.record == law.record


def test_names_and_bytes(folder):
    """No struct has a name that MATLAB reserves, the script names them all, and the same content has the same bytes."""
    names = {name for name in loadmat(folder / "all.mat", simplify_cells=True) if not name.startswith("__")}
    assert names == {"vehicle", "I", "II", "state_printed", "I_printed", "II_printed", "law", "end_2"}
    assert not names & RESERVED_WORDS
    text = (folder / "all_ss.m").read_text()
    assert all(f"{name} = ss(file.{name}.A" in text for name in names - {"vehicle"})
    vehicle = read_vehicle("quarter_car")
    controllers = [Designer(vehicle, search=False).design("I_printed")]
    assert mat_file(vehicle, controllers) == mat_file(vehicle, controllers)


def test_json_names_the_files(tmp_path, capsys):
    """--json names the files, certificates among them."""
    assert main(["--controller", "I_printed", "--export", str(tmp_path / "x.mat"), "--json"]) == 0
    printed = prose(capsys.readouterr().out)
    assert all(name in printed for name in ("x_ss.m", "x_certificates/I_printed.json", "x_certificates/check_certificate.py"))
