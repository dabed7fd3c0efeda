"""Keep pyulog from reading a damaged file without end, or a small one into all the memory there is."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

# A hundred topics of PX4 have some three thousand fields.
_MOST_FIELDS = 2**18


class Unreadable(Exception):
    """Say why a file is given up; pyulog passes it on, as it does not with a ValueError."""


def open_forward(path: Path) -> io.BufferedReader:
    """Open a file in which what was cut short is not read again.

    pyulog steps over a damaged header by going back as far as the message was to be long: at the end of a
    file that is further than it has read, and it would come by there for ever.
    """
    return _Forward(path)


class _Forward(io.BufferedReader):
    """Raise Unreadable where one goes back from the end of the file for a second time, and no less far."""

    def __init__(self, path: Path) -> None:
        super().__init__(io.FileIO(path))
        self._end = path.stat().st_size
        self._back_at = -1

    def seek(self, offset: int, whence: int = io.SEEK_SET, /) -> int:
        if whence != io.SEEK_CUR:
            self._back_at = -1
        elif (now := self.tell()) >= self._end:
            if now + offset <= self._back_at:
                raise Unreadable("it ends inside a message")
            self._back_at = now + offset
        return super().seek(offset, whence)


def bounded_ulog() -> type[Any]:
    """Return pyulog's ULog for one reading: formats that unfold to too many fields raise Unreadable."""
    from pyulog import ULog

    left = _MOST_FIELDS

    class Subscription(ULog._MessageAddLogged):  # type: ignore[misc]
        def _parse_nested_type(self, prefix: str, name: str, formats: dict[str, Any]) -> None:
            nonlocal left
            left -= 1 + sum(max(array_size, 1) for _, array_size, _ in formats[name].fields)
            if left < 0:
                raise Unreadable(f"its messages have more than {_MOST_FIELDS} fields")
            super()._parse_nested_type(prefix, name, formats)

    class Bounded(ULog):  # type: ignore[misc]
        _MessageAddLogged = Subscription

    return Bounded
