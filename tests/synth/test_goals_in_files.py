"""Goals in vehicle files: read, refused in one line, saved, and shown in JSON and pictures."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from models.common.errors import InputError
from models.common.schema import required_keys
from models.document.figure import Spans
from models.laws.goals import BOUNDS
from models.vehicle.vehicle import parse_vehicle, read_vehicle
from synth.analysis.specification import Specification
from synth.analysis.twice_precision import gain_at
from synth.command.responses import responses_figure
from synth.command.table import Row
from synth.vehicle.designer import Designer
from tests.support import shared
from tests.support.commands import main_of, refused
from tests.support.goals import BAND, HZ, KEPT, ONE, THREE, TWO, vehicle_with


def test_a_family_from_a_file(tmp_path):
    """A table of factors, or TOML, stands for the list that it holds, in the text that logs and saved files carry, too."""
    rows = [(0.7, 0.75), (1.0, 1.25)]
    (tmp_path / "fleet.csv").write_text("sprung_mass,tyre_stiffness\n" + "".join(f"{a},{b}\n" for a, b in rows))
    listed = ", ".join(f"{{ sprung_mass = {a}, tyre_stiffness = {b} }}" for a, b in rows)
    (tmp_path / "fleet.toml").write_text(f"family = [{listed}]")
    (tmp_path / "windows.csv").write_bytes((tmp_path / "fleet.csv").read_bytes().replace(b"\n", b"\r\n"))
    path = tmp_path / "car.toml"
    for name in ("fleet.csv", "fleet.toml", "windows.csv"):
        text = vehicle_with(f"measured = {TWO}").text + f'family = "{name}"\n'
        path.write_text(text)
        vehicle = read_vehicle(path)
        goals = parse_vehicle(vehicle.text).controllers["goal"].goals
        assert goals is not None
        assert [dict(member) for member in goals.family] == [{"sprung_mass": a, "tyre_stiffness": b} for a, b in rows]
        assert tmp_path / name in vehicle.files
    for wrong, said in (("colour\n1.0", "family[0]: unknown parameter 'colour'"), ("colour\nx", "give a .toml file")):
        (tmp_path / name).write_text(wrong)
        with refused("[controllers.goal]", said):
            read_vehicle(path)


def test_a_given_gain_is_judged_by_its_goals(tmp_path, capsys):
    """The printed controller I, with a tolerance of 22 %, is unstable within it; the command says so and exits 1."""
    path = tmp_path / "car.toml"
    section = f"measured = {TWO}\ngain = [[10824.0, -2071.0]]\ntolerance = {{ suspension_deflection = 0.22 }}\n"
    path.write_text(vehicle_with(section).text)
    assert main_of("synth")(["--vehicle", str(path), "--controller", "goal", "--json"]) == 1
    row = json.loads(capsys.readouterr().out)["controllers"][0]
    worst = next(promise for promise in row["promises"] if "errors" in promise["promise"])
    assert worst["value"] is None
    assert not worst["holds"]
    assert any("with errors" in failure for failure in row["failures"])


def test_saved_goals_are_checked_again(tmp_path, capsys):
    """A design with its goals is saved with them, and checked by them; a bound made stricter than the gain keeps fails."""
    bound = '{ peak = "suspension_deflection", road = "bump:height=0.08", speed = 10.0, at_most = 0.09 }'
    section = f"measured = {ONE}\n{BAND}\nbounds = [{{ norm = 9.63 }}, {bound}]\n"
    path, saved = tmp_path / "car.toml", tmp_path / "saved.toml"
    path.write_text(vehicle_with(section).text)
    assert main_of("synth")(["--vehicle", str(path), "--controller", "goal", "--save", str(saved), "-v"]) == 0
    assert main_of("synth")(["--check", str(saved)]) == 0
    assert "norm from 4 to 8 Hz" in capsys.readouterr().out
    saved.write_text(saved.read_text().replace('"norm" = 9.63', '"norm" = 7.8').replace("norm = 9.63", "norm = 7.8"))
    assert main_of("synth")(["--check", str(saved)]) == 1
    assert "not met: norm" in " ".join(capsys.readouterr().out.split())


def test_what_is_no_bound_is_offered_every_kind():
    """An unknown bound is answered by one of each kind, and each of those is read."""
    with pytest.raises(InputError) as error:
        vehicle_with(f"measured = {TWO}\nbounds = [{{ foo = 1 }}]")
    offered = re.findall(r"\{ (?!foo)[^}]*\}", str(error.value).partition("one of")[2])
    assert [text.split()[1] for text in offered] == [required_keys(one)[0] for one in BOUNDS]
    bounds = ", ".join(offered).replace("SIGNAL", '"suspension_deflection"').replace("ROAD", '"bump"')
    goals = vehicle_with(f"measured = {TWO}\nbounds = [{bounds}]").controllers["goal"].goals
    assert goals is not None
    assert len(goals.bounds) == len(BOUNDS)


@pytest.mark.parametrize(
    ("bound", "said"),
    [
        ('peak = "suspension_deflection", road = "mountain"', "bounds[1] road = 'mountain': unknown road"),
        ('peak = "suspension_deflection", road = "absent.csv"', "bounds[1] road = 'absent.csv': road file absent.csv: "),
        (
            'peak = "suspension_deflection", road = "iso8608:class=C"',
            "bounds[1] road = 'iso8608:class=C' is a road that does not end",
        ),
    ],
)
def test_a_bound_that_cannot_be_is_named_with_its_file(bound, said, tmp_path):
    """A mistake that shows where a bound is posed, not read, names the vehicle file and the bound, of designs and gains alike."""
    path = tmp_path / "car.toml"
    for gain in ("", "gain = [[1e4, -2e3]]"):
        goal = f"measured = {TWO}\n{gain}\nbounds = [{{ decay = 0.1 }}, {{ {bound}, at_most = 0.1 }}]"
        path.write_text(vehicle_with(goal).text)
        with refused(match=re.escape(f"vehicle file {path}: [controllers.goal] {said}")):
            Designer(read_vehicle(path)).design("goal")


def test_a_design_for_goals_is_not_refined(tmp_path, capsys):
    """`--refine` would leave its goals: it is not advised."""
    path = tmp_path / "car.toml"
    path.write_text(vehicle_with(f"measured = {TWO}\nbounds = [{{ gain = 1e4 }}]").text)
    assert main_of("synth")(["--vehicle", str(path), "--controller", "goal", "-v"]) == 0
    assert "--refine" not in capsys.readouterr().out


@pytest.mark.attack
def test_json_of_the_shipped_goals():
    """Every promise of the shipped file is there in JSON, and holds."""
    done = shared.printed("synth", "--vehicle", "quarter_car_goals", "--json")
    assert done.code == 0
    rows = done.json["controllers"]
    promises = [promise for row in rows for promise in row.get("promises", [])]
    assert len(promises) >= 12
    assert all(promise["holds"] is True for promise in promises)


@pytest.mark.attack
def test_the_picture_of_a_band(tmp_path, capsys):
    """Curves are the loops' largest gains, the band is shaded, and what is proved in it lies on no point of the curve there."""
    vehicle = vehicle_with(f"measured = {THREE}\n{BAND}\nbounds = [{KEPT}]")
    controller = shared.designed(vehicle, "goal")
    figure = responses_figure(vehicle, [Row("goal", controller, (), ())])
    assert figure is not None
    (panel,) = figure.panels
    assert isinstance(panel.ground, Spans)
    assert panel.ground.ends == ((4.0, 8.0),)
    response, level = panel.curves
    loop = controller.loop(vehicle)
    for at in (0, 700, -1):
        assert response.y[at] == pytest.approx(gain_at(loop, HZ * response.x[at]), rel=1e-9)
    inside = (response.x >= 4) & (response.x <= 8)
    assert response.y[inside].max() <= level.y[0] == controller.specifications[0].proved
    assert response.y.max() > 5 * level.y[0]  # what lies beside the band is not hidden
    assert response.y.max() == pytest.approx(controller.certificate.norm.value, rel=1e-9)  # its peak is between no two points
    path = tmp_path / "car.toml"
    path.write_text(f"{vehicle.text}gain = {controller.gain.tolist()}\n")  # which is designed already
    assert main_of("synth")(["--vehicle", str(path), "--controller", "goal", "--picture", str(tmp_path / "bands.png"), "-v"]) == 0
    assert "bands.png" in capsys.readouterr().out
    assert (tmp_path / "bands.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(InputError, match="is an input file"):
        main_of("synth")(["--vehicle", str(path), "--picture", str(path), "-v"])


def test_what_is_not_proved_has_no_bound():
    """A promise without a proved bound, as where a proof was ended early, says so, and is not kept."""
    open_ = Specification("norm", 6.0, proved=np.inf, at_most=7.0)
    assert open_.text == "norm is 6, but no bound is proved; at most 7 is allowed"
    assert (open_.proved_text, open_.holds) == ("not proved", False)
    assert replace(open_, proved=6.5).text == "norm is 6, which is proved to be at most 6.5; at most 7 is allowed"
