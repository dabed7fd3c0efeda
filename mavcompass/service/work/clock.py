"""The date, for records that people read: the one place where the service asks the computer for it."""

from __future__ import annotations

from datetime import UTC, datetime


def now() -> datetime:
    """Return the time, UTC. It steps where a receiver or a network sets the computer's clock."""
    return datetime.now(UTC)


def utc_now() -> str:
    """Return the time, UTC, ISO 8601, to the second."""
    return now().isoformat(timespec="seconds")
