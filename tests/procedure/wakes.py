"""No procedure asks to be woken in the past: its driver would spin."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import pytest

from mavcompass.procedure.script import Machine


@pytest.fixture(autouse=True, scope="session")
def no_script_spins() -> Iterator[None]:
    """Look at every step of every script that a test runs."""
    resume = Machine._resume

    def resumed(machine: Machine[object], advance: Callable[[], float]) -> None:
        resume(machine, advance)
        assert machine.done or machine.wake_at_s >= machine.context.now, "it asks to be woken in the past"

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Machine, "_resume", resumed)
        yield
