"""Which tests run a line, and how long each takes: what `scripts/coverage` has found."""

from __future__ import annotations

import json
import subprocess
import sys
from collections import defaultdict
from pathlib import Path

from coverage import CoverageData

from mutation.sites import Site
from mutation.test_contexts import SECONDS


def is_measured(project: Path) -> bool:
    """Tell whether `scripts/coverage` has run."""
    return (project / SECONDS).exists() and (project / ".coverage").exists()


def _collected(project: Path) -> set[str]:
    """List the tests that there are."""
    command = [sys.executable, "-m", "pytest", "--collect-only", "-q", "-n", "0", "-p", "no:cacheprovider"]
    told = subprocess.run(command, cwd=project, capture_output=True, text=True, check=True).stdout
    return {line for line in told.splitlines() if "::" in line}


class Covering:
    """Look up tests by the lines that they run."""

    def __init__(self, project: Path) -> None:
        """Read what was found. Raises FileNotFoundError before `scripts/coverage` has run."""
        self.project = project
        measured: dict[str, float] = json.loads((project / SECONDS).read_text())
        # To ask for a test that has gone since is an error, which would pass for a mutant that is noticed.
        self.seconds = {name: measured[name] for name in _collected(project) & measured.keys()}
        self._data = CoverageData(str(project / ".coverage"))
        self._data.read()
        self._of_file: dict[str, set[str]] = defaultdict(set)
        for name in self.seconds:
            self._of_file[name.partition("::")[0]].add(name)

    def tests(self, site: Site) -> list[str]:
        """Return the tests that run a place, the quickest first."""
        lines = self._data.contexts_by_lineno(str(self.project / site.path))
        # What a file does when it is loaded matters to whoever runs anything of it.
        wanted = [site.line] if site.in_function else list(lines)
        found: set[str] = set()
        for context in {context for line in wanted for context in lines.get(line, ())}:
            phase, _, name = context.partition(" ")
            if phase == "test" and name in self.seconds:
                found.add(name)
            elif phase == "file":  # a fixture of all its tests
                found |= self._of_file[name]
        return sorted(found, key=lambda name: self.seconds[name])

    def is_older_than(self, file: str) -> bool:
        """Tell whether a file of tests was changed since."""
        return (self.project / file).stat().st_mtime > (self.project / ".coverage").stat().st_mtime
