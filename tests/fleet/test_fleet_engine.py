"""A task that goes wrong costs only itself."""

from __future__ import annotations

import gc
import os
import signal
import time
from collections.abc import Iterator

import pytest
from fleet_samples import square

from mavcompass.errors import MavCompassError
from mavcompass.fleet import engine
from mavcompass.fleet.engine import Engine
from mavcompass.workers import DIED, TIMEOUT, Answer, Child, Children


def answers(numbers: list[int], workers: int = 2, timeout_s: float = 30.0) -> dict[int, Answer]:
    tasks = [(number,) for number in numbers]
    return {task[0]: answer for task, answer in Engine(workers, None, timeout_s).run(square, tasks)}


@pytest.fixture
def started(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """The ids of the processes that a test starts."""
    pids: list[int] = []
    start = Child.__init__

    def remembered(child: Child) -> None:
        start(child)
        pids.append(child.pid)

    monkeypatch.setattr(Child, "__init__", remembered)
    return pids


def is_alive(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return True


def test_every_task_is_answered_once() -> None:
    done = [(task[0], answer.value) for task, answer in Engine(2).run(square, [(n,) for n in range(40)])]
    assert sorted(done) == [(number, number * number) for number in range(40)]


def test_no_tasks_need_no_process(started: list[int]) -> None:
    assert answers([]) == {} and started == []


def test_a_task_that_ends_its_process_or_raises_costs_only_itself(started: list[int]) -> None:
    done = answers([1, 2, -1, 3, -2, 4, 5])
    assert [done[n].value for n in (1, 2, 3, 4, 5)] == [1, 4, 9, 16, 25]
    died, raised = done[-1].failure, done[-2].failure
    assert died is not None and died.kind == DIED and "exit code 7" in died.text
    assert raised is not None and (raised.kind, raised.text) == ("ValueError", "no square of minus two")
    # Only the dead one was replaced; on a busy machine one of the two may have done all the work.
    assert 2 <= len(started) <= 3 and not any(map(is_alive, started))


def test_a_task_over_its_time_is_stopped() -> None:
    began = time.monotonic()
    done = answers([-3, 1, 2, 3], timeout_s=3.0)
    assert time.monotonic() - began < 30.0
    late = done[-3].failure
    assert late is not None and late.kind == TIMEOUT and "3 s" in late.text
    assert [done[n].value for n in (1, 2, 3)] == [1, 4, 9]


def test_what_a_library_prints_does_not_disturb_the_answers() -> None:
    assert answers([-4, 3], workers=1) == {-4: Answer(16), 3: Answer(9)}


def test_an_error_that_cannot_travel_is_told_all_the_same() -> None:
    failure = answers([-5])[-5].failure
    assert failure is not None and (failure.kind, failure.text) == ("Stubborn", "two words")
    assert failure.error is None


def test_processes_end_when_the_reader_of_the_answers_stops(started: list[int]) -> None:
    running: Iterator[object] = Engine(2).run(square, [(1,), (-3,), (-3,)])
    next(running)
    running.close()  # type: ignore[attr-defined]
    assert len(started) == 2 and not any(map(is_alive, started))


def test_a_process_that_cannot_begin_ends_the_work(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("sys.executable", "/bin/false")
    with pytest.raises(MavCompassError, match="ended with code 1 before it could begin"):
        answers([1, 2])


def test_a_worker_process_ends_with_its_owner() -> None:
    child = Child()
    pid = child.pid
    del child
    gc.collect()
    assert not is_alive(pid)


def test_a_worker_process_ends_with_its_parent_even_at_work() -> None:
    child = Child()
    child._line.send((square, (-3,)))
    assert child._line.recv() == "ready"
    child._line.close()  # what the kernel does when the parent is killed
    assert child._process.wait(timeout=10.0) == 3


def test_a_clusters_worker_keeps_its_process_until_a_task_kills_it(
    monkeypatch: pytest.MonkeyPatch, started: list[int]
) -> None:
    with Children() as children:
        monkeypatch.setattr(engine, "_of_this_process", children)
        assert engine.isolated(square, (3,), 30.0).value == 9
        died = engine.isolated(square, (-1,), 30.0).failure
        assert died is not None and died.kind == DIED
        assert [engine.isolated(square, (number,), 30.0).value for number in (4, 5)] == [16, 25]
        assert len(started) == 2
        engine.end_idle()
        assert not any(map(is_alive, started))


def test_a_signal_is_told_by_its_name() -> None:
    failure = answers([-6])[-6].failure
    assert failure is not None and f"signal {signal.SIGSEGV.value}, Segmentation fault" in failure.text
