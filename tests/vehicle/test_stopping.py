"""Ctrl-C and SIGTERM while something is at work: a wish, unless it hangs."""

from __future__ import annotations

import signal

import pytest

from mavcompass.vehicle import stopping
from mavcompass.vehicle.stopping import StopRequest, stop_signals


@pytest.mark.parametrize(
    ("number", "reason"),
    [(signal.SIGINT, "Stopped by Ctrl-C."), (signal.SIGTERM, "Stopped by the system (SIGTERM).")],
)
def test_a_signal_is_a_wish_and_two_within_a_second_are_one(
    number: int, reason: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s, stop = [0.0], StopRequest()
    monkeypatch.setattr(stopping, "monotonic", lambda: now_s[0])
    before = signal.getsignal(number)
    with stop_signals(stop):
        for now_s[0], presses in ((0.5, 1), (1.4, 1), (1.6, 2), (2.5, 2), (2.7, 3)):
            signal.raise_signal(number)
            assert (stop.reason, stop.presses) == (reason, presses)
            stop.noted_s = now_s[0]
        now_s[0] = 4.6
        signal.raise_signal(number)
        now_s[0] = 4.8  # what has not looked for two seconds hangs
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(number)
    assert signal.getsignal(number) is before
