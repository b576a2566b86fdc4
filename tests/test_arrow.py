"""The writer of logs imports nothing that nobody asked for."""

import subprocess
import sys

import pytest

CODE = """
import sys
from sim.bump import main

assert main(["--controller", "passive", "--duration", "0.1", "--logs", "logs"]) == 0
assert "rerun" in sys.modules and "pandas" not in sys.modules
finders = [type(finder).__name__ for finder in sys.meta_path]
import pyarrow

frame = pyarrow.table({"a": [1.0, None]}).to_pandas()
assert frame["a"].isna().tolist() == [False, True]
assert pyarrow.array(frame["a"]).to_pylist() == [1.0, None], "Arrow knows pandas' objects once it has been asked for them"
assert "_NoPandas" not in finders
"""


@pytest.mark.attack
def test_a_log_does_not_load_pandas(tmp_path):
    """A command that records leaves pandas out, where Arrow would import it unasked; what asks for it afterwards has it."""
    pytest.importorskip("pandas", reason="needs the extra [report]")
    run = subprocess.run([sys.executable, "-c", CODE], capture_output=True, text=True, cwd=tmp_path)
    assert run.returncode == 0, run.stderr
