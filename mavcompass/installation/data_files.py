"""Find the files of `params/`: beside the package in a checkout, inside it where a wheel was installed."""

from __future__ import annotations

from pathlib import Path

from mavcompass.errors import MavCompassError

_PACKAGE = Path(__file__).resolve().parents[1]


def params_path(name: str = "") -> Path:
    """Find a file or folder of `params/` by its relative name, such as "vehicles/rover.toml".

    Raises
    ------
    MavCompassError
        When this installation has no such file.
    """
    installed = _PACKAGE / "_params"
    folder = installed if installed.is_dir() else _PACKAGE.parent / "params"
    path = folder / name
    if not path.exists():
        raise MavCompassError(
            f"The data file {path} is missing from this installation of mavcompass.",
            "Install mavcompass again, or run it from a complete checkout.",
        )
    return path
