"""What a person is told of a recording, in the same words whatever its format."""

from __future__ import annotations

from collections.abc import Sized

from mavcompass.logs.common.boot_clock import BootClock


def restarts(clock: BootClock) -> list[str]:
    """Tell of power-ups after the first."""
    starts = clock.shift_s.size
    if starts < 2:
        return []
    at = ", ".join(f"{start:.1f}" for start in clock.start_s[1:6])
    return [f"The autopilot was started {starts} times; time_s goes on across the restarts (at {at} s)."]


def damage(skipped_bytes: int, stretches: int, read: str, at_the_end: bool = False) -> list[str]:
    """Tell of bytes that were left out; `read` says what was read all the same."""
    if not skipped_bytes:
        return []
    places = "1 place" if stretches == 1 else f"{stretches} places"
    where = "its end" if at_the_end and stretches == 1 else places
    return [f"The recording is damaged at {where}: {skipped_bytes} bytes were left out, {read} were read."]


def said_nothing(instance: int, silent: int, field: Sized) -> list[str]:
    """Tell that a compass was read in vain now and then; `field` is what it said otherwise."""
    if not silent:
        return []
    of = f"{silent} of {silent + len(field)} readings"
    return [f"Compass {instance} said nothing (zero on every axis) in {of}: left out."]


def unknown_correction(instance: int) -> str:
    """Tell that the correction inside a compass's readings is not known."""
    return (
        f"The parameters of compass {instance} are not in the recording, or no compass can have them: its "
        "readings are taken as they are, with whatever correction was inside them."
    )
