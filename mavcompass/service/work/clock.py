"""The date, for records that people read, and what is due when: only here the computer is asked for it."""

from __future__ import annotations

from datetime import UTC, datetime


def now() -> datetime:
    """Return the time, UTC. It steps where a receiver or a network sets the computer's clock."""
    return datetime.now(UTC)


def utc_now() -> str:
    """Return the time, UTC, ISO 8601, to the second."""
    return now().isoformat(timespec="seconds")


class Schedule:
    """Remember when each thing was last done, on a clock that may begin anew when a link is opened again."""

    def __init__(self) -> None:
        self._done_s: dict[str, float] = {}

    def is_due(self, name: str, now_s: float, every_s: float) -> bool:
        """Tell whether a thing is due, and if so count it as done now."""
        done_s = self._done_s.get(name)
        if done_s is not None and done_s <= now_s < done_s + every_s:
            return False
        self._done_s[name] = now_s
        return True

    def next_s(self, name: str, now_s: float, every_s: float) -> float:
        """Return when a thing is due next."""
        done_s = self._done_s.get(name)
        return now_s if done_s is None or done_s > now_s else done_s + every_s

    def hurry(self, *names: str) -> None:
        """Make things due at once."""
        for name in names:
            self._done_s.pop(name, None)

    def clear(self) -> None:
        """Make everything due at once."""
        self._done_s.clear()
