"""What the numbers depend on beside their sources."""

import platform
from importlib import metadata

PACKAGES = ("roadproof", "mujoco", "numpy", "scipy", "mcap", "protobuf", "foxglove-schemas-protobuf", "rerun-sdk")


def versions() -> dict[str, str]:
    """Version of everything that the numbers depend on."""
    found = {"python": platform.python_version()}
    for package in PACKAGES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:  # run from a checkout that was never installed
            found[package] = "not installed"
    return found
