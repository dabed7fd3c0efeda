"""The date, for records that people read."""

from __future__ import annotations

from datetime import UTC, datetime


def utc_now() -> str:
    """Return the time, UTC, ISO 8601, to the second."""
    return datetime.now(UTC).isoformat(timespec="seconds")
