"""Text from outside, as it may stand on a terminal, in a log and in a report."""

from __future__ import annotations


def printable(text: object) -> str:
    """Spell out (\\x1b, \\n) what would move a terminal's cursor, colour it, or begin another line."""
    return "".join(
        letter if letter.isprintable() else letter.encode("unicode_escape").decode() for letter in str(text)
    )
