"""The vehicle's clock out of messages that carry it, through late messages, restarts and jumping clocks."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from mavcompass.logs.common.boot_clock import BootClock, build_clock, impossible_times
from mavcompass.logs.common.samples import in_order


def clock(boot_s: np.ndarray, log_s: np.ndarray) -> BootClock:
    return build_clock(np.arange(boot_s.size, dtype=np.uint32) * 2, log_s, boot_s)


def odd(places: np.ndarray | list[int]) -> np.ndarray:
    return (np.asarray(places) * 2 + 1).astype(np.uint32)


def test_one_power_up_keeps_the_vehicles_own_time() -> None:
    boot_s = 20.0 + 0.1 * np.arange(100)
    found = clock(boot_s, boot_s + 1.7e9)
    np.testing.assert_array_equal(found.from_boot(odd(range(100)), boot_s), boot_s)
    assert found.utc_offset_s() == pytest.approx(1.7e9)
    assert found.start_s.tolist() == [20.0]
    assert found.log_jumps == 0


@settings(deadline=None)
@given(
    st.lists(
        # A power-up lasts four seconds at least: no autopilot boots and speaks in less.
        st.tuples(st.floats(1.0, 500.0), st.integers(45, 90), st.floats(3.0, 900.0)),
        min_size=1,
        max_size=5,
    ),
    st.integers(0, 2**32 - 1),
)
def test_time_goes_on_across_any_restarts(parts: list[tuple[float, int, float]], seed: int) -> None:
    rng = np.random.default_rng(seed)
    boots, logs, true = [], [], []
    now, last_boot = 1.7e9, 0.0
    for first_boot, count, pause in parts:
        first_boot = min(first_boot, max(last_boot - 3.0, 0.0)) if boots else first_boot
        boot_s = first_boot + 0.1 * np.arange(count)
        boots.append(boot_s)
        true.append(now + boot_s - first_boot)
        logs.append(true[-1] + rng.uniform(0.0, 0.05, count))
        now += 0.1 * count + pause
        last_boot = float(boot_s[-1])
    boot_s, log_s, true_s = (np.concatenate(x) for x in (boots, logs, true))
    found = clock(boot_s, log_s)
    order = np.arange(boot_s.size, dtype=np.uint32) * 2
    time_s = found.from_boot(order, boot_s)
    assert bool((np.diff(time_s) > 0.0).all())
    np.testing.assert_allclose(time_s - time_s[0], true_s - true_s[0], atol=0.06 * len(parts))


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_what_has_no_time_lies_between_its_neighbours(seed: int) -> None:
    rng = np.random.default_rng(seed)
    boot_s = 5.0 + np.cumsum(rng.uniform(0.01, 0.2, 200))
    log_s = 1.7e9 + np.maximum.accumulate(boot_s + rng.exponential(0.5, 200))
    between = rng.integers(0, 199, 50)
    heard_s = log_s[between] + rng.uniform(0.0, 1.0, 50) * (log_s[between + 1] - log_s[between])
    placed_s = clock(boot_s, log_s).from_log(odd(between), heard_s)
    assert bool((placed_s >= boot_s[between]).all())
    assert bool((placed_s <= boot_s[between + 1]).all())


def test_short_outbreaks_of_a_clock_are_found_and_lasting_steps_are_not() -> None:
    times = np.arange(50.0)
    times[[10, 30]] = [1e9, -5.0]
    assert impossible_times(times).tolist() == [10, 30]
    stepped = np.concatenate([np.arange(50.0), 1000.0 + np.arange(50.0)])
    assert impossible_times(stepped).tolist() == []


def test_repeats_are_told_from_samples_that_share_a_time() -> None:
    rows = np.rec.fromrecords([(1,), (1,), (2,), (3,), (2,)], names="x")
    times, kept, repeats = in_order(np.array([0.0, 0.0, 0.0, 1.0, 0.0]), rows)
    assert (times.tolist(), kept.x.tolist(), repeats) == ([0.0, 0.0, 1.0], [1, 2, 3], 2)
    times, kept, repeats = in_order(np.array([0.0, 0.0]), rows[:2], own_time=False)
    assert (kept.size, repeats) == (2, 0)
