"""How this program is called on this computer, for the commands that it tells a person to type."""

from __future__ import annotations

import os
import shlex
import shutil
import sys
from pathlib import Path

CALLED = "MAVCOMPASS_CALLED"  # set by the launcher of a checkout: how the person called it


def program() -> str:
    """Spell the program as it can be typed here: as it was called, by its name, or by its path."""
    if called := os.environ.get(CALLED):
        return shlex.quote(called)
    script = Path(sys.argv[0])
    if script.name == "mavcompass" and shutil.which(script.name) is None:
        return shlex.quote(str(script))
    return "mavcompass"


def consent() -> str:
    """Spell the option that a writing command needs here: none where a person can be asked."""
    return "" if sys.stdin is not None and sys.stdin.isatty() else " --yes"


def pip_install(requirement: str) -> str:
    """Spell the command that installs into the environment that runs this, whichever is active."""
    beside = Path(sys.executable).parent
    found = shutil.which("pip")
    active = found is not None and Path(found).parent == beside
    pip = "pip" if active else f"{shlex.quote(sys.executable)} -m pip"
    return f"{pip} install '{requirement}'"
