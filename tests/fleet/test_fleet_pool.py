"""A task that goes wrong costs only itself."""

from __future__ import annotations

import os
import time
from collections.abc import Iterator

import pytest
from fleet_samples import square

from mavcompass.fleet.child import DIED, TIMEOUT, Answer, Child
from mavcompass.fleet.cluster import isolated
from mavcompass.fleet.pool import run_in_processes


def answers(numbers: list[int], workers: int = 2, timeout_s: float = 30.0) -> dict[int, Answer]:
    tasks = [(number,) for number in numbers]
    return {task[0]: answer for task, answer in run_in_processes(square, tasks, workers, timeout_s)}


def test_every_task_is_answered_once() -> None:
    tasks = [(number,) for number in range(40)]
    done = [(task[0], answer.value) for task, answer in run_in_processes(square, tasks, 2, 30.0)]
    assert sorted(done) == [(number, number * number) for number in range(40)]


def test_no_tasks_need_no_process() -> None:
    assert answers([]) == {}


def test_a_task_that_ends_its_process_or_raises_costs_only_itself() -> None:
    done = answers([1, 2, -1, 3, -2, 4, -1, 5])
    assert [done[n].value for n in (1, 2, 3, 4, 5)] == [1, 4, 9, 16, 25]
    died, raised = done[-1].failure, done[-2].failure
    assert died is not None and died.kind == DIED and "exit code 7" in died.text
    assert raised is not None and (raised.kind, raised.text) == ("ValueError", "no square of minus two")


def test_a_task_over_its_time_is_stopped() -> None:
    began = time.monotonic()
    done = answers([-3, 1, 2, 3], timeout_s=5.0)
    assert time.monotonic() - began < 30.0
    late = done[-3].failure
    assert late is not None and late.kind == TIMEOUT and "5 s" in late.text
    assert [done[n].value for n in (1, 2, 3)] == [1, 4, 9]


def test_what_a_library_prints_does_not_disturb_the_answers() -> None:
    assert answers([-4, 3], workers=1) == {-4: Answer(16), 3: Answer(9)}


def test_processes_end_when_the_reader_of_the_answers_stops(monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[Child] = []
    start = Child.__init__

    def remembered(child: Child) -> None:
        start(child)
        started.append(child)

    monkeypatch.setattr(Child, "__init__", remembered)
    running: Iterator[object] = run_in_processes(square, [(1,), (-3,), (-3,)], 2, 30.0)
    next(running)
    running.close()  # type: ignore[attr-defined]
    assert len(started) == 2
    for child in started:
        with pytest.raises(ProcessLookupError):
            os.kill(child.pid, 0)


def test_a_worker_process_ends_with_its_parent_even_at_work() -> None:
    child = Child()
    child.give(square, (-3,), 30.0)
    assert child.receive() is None  # ready
    assert child._process.stdin is not None
    child._process.stdin.close()  # what the kernel does when the parent is killed
    assert child._process.wait(timeout=10.0) == 3
    child.kill()


def test_a_cluster_thread_keeps_its_process_until_a_task_kills_it() -> None:
    assert isolated(square, (3,), 30.0).value == 9
    died = isolated(square, (-1,), 30.0).failure
    assert died is not None and died.kind == DIED
    assert isolated(square, (4,), 30.0).value == 16
    assert isolated(square, (5,), 30.0).value == 25
