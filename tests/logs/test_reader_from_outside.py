"""A new reader is one new file: nothing else names it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from mavcompass.errors import BadRecording
from mavcompass.logs import formats, read_track
from mavcompass.logs.reading import known_formats

DIVERS_NOTES = '''
    """A diver's notes: a line of four numbers for each reading."""

    from pathlib import Path

    import numpy as np

    from mavcompass.correction import IDENTITY
    from mavcompass.track import InForce, MagSeries, Series, Track

    NAME = "diver's notes (.dive)"
    SUFFIXES = (".dive",)


    def recognises(head: bytes) -> bool:
        return head.startswith(b"DIVE")


    def read(path: Path, head: bytes) -> dict[int, Track]:
        rows = np.loadtxt(path, skiprows=1)
        reported = Series.of(rows[:, 0], rows[:, 1:])
        compass = MagSeries(1, reported, (InForce(-np.inf, IDENTITY),))
        return {1: Track(source=str(path), compasses={1: compass})}
'''


@pytest.fixture
def divers_notes(add_file: Callable[[ModuleType, str, str], None]) -> Iterator[None]:
    add_file(formats, "divers_notes", DIVERS_NOTES)
    known_formats.cache_clear()
    yield
    known_formats.cache_clear()


@pytest.mark.parametrize("name", ["wreck.dive", "wreck.txt"])
@pytest.mark.usefixtures("divers_notes")
def test_a_file_in_the_folder_is_a_reader(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_text("DIVE 7\n0.0 230.0 50.0 -530.0\n0.1 231.0 49.0 -530.0\n")
    compass = read_track(path).compasses[1]
    assert compass.reported.values == pytest.approx(np.array([[230.0, 50.0, -530.0], [231.0, 49.0, -530.0]]))


@pytest.mark.usefixtures("divers_notes")
def test_a_person_is_told_of_it(tmp_path: Path) -> None:
    (tmp_path / "strange.xyz").write_text("?")
    with pytest.raises(BadRecording, match=r"diver's notes \(\.dive\)"):
        read_track(tmp_path / "strange.xyz")
