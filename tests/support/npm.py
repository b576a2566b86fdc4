"""Packages of JavaScript's, for tests that read what is written here with other readers."""

import shutil
import subprocess
from pathlib import Path

import pytest


def installed(packages: tuple[str, ...], folder: Path) -> Path:
    """If `node` finds these packages, from the npm registry; skips the test where they cannot be had."""
    if not (shutil.which("node") and shutil.which("npm")):
        pytest.skip("node and npm are not installed")
    install = ["npm", "install", "--silent", "--no-audit", "--no-fund", "--prefix", str(folder), *packages]
    try:
        subprocess.run(install, check=True, capture_output=True, timeout=120)
    except (subprocess.CalledProcessError, subprocess.TimeoutExpired) as error:
        pytest.skip(f"npm cannot fetch {', '.join(packages)}: {error}")
    return folder / "node_modules"
