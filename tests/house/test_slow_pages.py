"""The sections of the pages whose commands take seconds to minutes: as `test_pages.py` has the others, after the suite."""

import pytest

from sim.studies.gallery import numbers
from tests.house.test_pages import SECTIONS, check, slow
from tests.support.shared import share


@pytest.fixture(autouse=True)
def gallery_once(monkeypatch):
    """Three pages show numbers of the gallery, which `test_gallery.py` holds."""
    share(monkeypatch, numbers, "compared")


@pytest.mark.attack
@pytest.mark.parametrize("one", [each for each in SECTIONS if slow(each)], ids=str)
def test_commands(one, tmp_path, monkeypatch, capsys):
    """Every command exits with 0, prints the lines that stand beside it, and draws the picture that is shown."""
    check(one, tmp_path, monkeypatch, capsys)
