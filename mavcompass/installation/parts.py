"""What an installation holds: the files of `params/`, and parts that a lean one may lack.

The files are beside the package in a checkout, inside it where a wheel was installed. A command can ask for
the parts that it needs before it begins.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from mavcompass.errors import MavCompassError, UsageError
from mavcompass.installation.invocation import pip_install

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


@dataclass(frozen=True, slots=True)
class Part:
    """Hold what needs a part, the extra of the package that brings it, and the modules it is made of."""

    need: str
    extra: str
    modules: tuple[str, ...]


PARTS = {
    part.need: part
    for part in (
        Part("A serial port", "serial", ("serial",)),
        Part("An HTML report", "report", ("jinja2",)),
        Part("A plot", "report", ("matplotlib",)),
        Part(
            "The service",
            "service",
            ("msgspec", "starlette", "uvicorn", "websockets", "prometheus_client", "segno"),
        ),
        Part("A fleet", "fleet", ("scipy",)),
        Part("A blind trial", "trial", ("scipy",)),
        Part("A ROS 2 bag", "ros", ("rosbags",)),
        Part("A Parquet table", "fleet", ("pyarrow",)),
        Part("A cluster (--scheduler)", "fleet", ("distributed",)),
        Part("An object store", "fleet", ("fsspec",)),
    )
}


def missing(part: Part) -> tuple[str, ...]:
    """Return the modules of a part that are not installed; nothing is imported."""
    return tuple(module for module in part.modules if find_spec(module) is None)


def _listed(names: tuple[str, ...]) -> str:
    return " and ".join((", ".join(names[:-1]), names[-1])) if len(names) > 1 else names[0]


def require(*needs: str) -> None:
    """Raise UsageError, with the one command that installs all that is missing, where a need cannot be met.

    Args:
        needs: keys of `PARTS`.
    """
    lacking = [(PARTS[need], modules) for need in needs if (modules := missing(PARTS[need]))]
    if not lacking:
        return
    sentences = [f"{p.need} needs {_listed(modules)}, not installed here." for p, modules in lacking]
    extras = ",".join(dict.fromkeys(part.extra for part, _ in lacking))
    raise UsageError(" ".join(sentences), f"Install it with: {pip_install(f'mavcompass[{extras}]')}")
