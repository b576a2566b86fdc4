"""Each case of the field has its right answers."""

import importlib
import re
import shlex
from functools import reduce
from pathlib import Path
from typing import Any

import pytest

from models.common.errors import InputError
from tests.evals import Case
from tests.support.commands import prose
from tests.support.shared import printed

FILES = sorted(path.stem for path in Path(__file__).parent.glob("*.py") if path.stem not in ("__init__", "test_evals"))
CASES = {name: importlib.import_module(f"tests.evals.{name}").CASES for name in FILES}
exec(
    re.findall(r"(?s)```python\n(.*?)```", Path(__file__).with_name("README.md").read_text(encoding="utf-8"))[0],
    example := dict[str, Any](),
)
EVERY = {f"{name}: {case.question}": case for name, cases in (CASES | {"README": example["CASES"]}).items() for case in cases}


@pytest.mark.parametrize("case", EVERY.values(), ids=EVERY)
def test_case(case: Case):
    """The command gives each right answer within the error of its source, or refuses what is wrong in one line."""
    command, *options = shlex.split(case.command)
    if case.refused:
        with pytest.raises(InputError) as refusal:
            printed(command, *options, files=case.files)
        assert [part for part in (*case.refused, "\n") if (part in str(refusal.value)) == (part == "\n")] == [], refusal.value
        return
    done = printed(command, *options, *(["--json"] if case.answers else []), files=case.files)
    assert done.code == 0
    for one in case.answers:
        found = reduce(lambda value, key: value[int(key) if key.isdigit() else key], one.at.split("."), done.json)
        assert found == pytest.approx(one.right, rel=one.within), (one.at, one.source)
    assert [part for part in case.says if part not in prose(f"{done.out} {done.err}")] == []
