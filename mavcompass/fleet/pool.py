"""A small pool of processes in which a task that kills its process costs only itself."""

from __future__ import annotations

import selectors
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from mavcompass.fleet.child import DIED, TIMEOUT, Answer, Child

Task = tuple[Any, ...]
_LOOK_UP_S = 1.0


def run_in_processes(
    function: Callable[..., Any],
    tasks: Iterable[Task],
    workers: int,
    timeout_s: float,
    on_wait: Callable[[list[tuple[Task, float]]], None] = lambda _: None,
) -> Iterator[tuple[Task, Answer]]:
    """Yield each task, its arguments, with its answer, as they are done.

    `on_wait` is told, about once a second, which tasks are under way and for how long, the longest first.
    A process that dies or is over its time is replaced. When the iterator is closed, or an error or an
    interrupt passes through it, the processes end at once.
    """
    waiting = iter(tasks)
    busy: dict[Child, Task] = {}
    alive: set[Child] = set()
    with selectors.DefaultSelector() as selector:

        def give_next(child: Child | None) -> None:
            """Give a child the next task; without one start it, without a task end it."""
            task = next(waiting, None)
            if task is None:
                if child is not None:
                    selector.unregister(child.replies)
                    child.kill()
                return
            if child is None:
                child = Child()
                alive.add(child)
                selector.register(child.replies, selectors.EVENT_READ, child)
            busy[child] = task
            child.give(function, task, timeout_s)

        try:
            for _ in range(workers):
                give_next(None)
            while busy:
                under_way = [(task, timeout_s - child.left_s()) for child, task in busy.items()]
                on_wait(sorted(under_way, key=lambda item: -item[1]))
                for child, answer in _answers(selector, busy):
                    task = busy.pop(child)
                    lost = answer.failure is not None and answer.failure.kind in (DIED, TIMEOUT)
                    if lost:
                        alive.discard(child)
                    give_next(None if lost else child)
                    yield task, answer
        finally:
            for child in alive:
                child.kill()


def _answers(selector: selectors.BaseSelector, busy: dict[Child, Task]) -> list[tuple[Child, Answer]]:
    """Wait for the next answers; children that are lost are taken off the selector."""
    soonest = min(child.left_s() for child in busy)
    answers: list[tuple[Child, Answer]] = []
    for key, _ in selector.select(min(max(soonest, 0.0), _LOOK_UP_S)):
        child: Child = key.data
        answer = child.receive()
        if answer is None:
            continue
        if answer.failure is not None and answer.failure.kind == DIED:
            selector.unregister(key.fileobj)
        answers.append((child, answer))
    answered = {child for child, _ in answers}
    for child in [c for c in busy if c not in answered and c.left_s() <= 0.0]:
        selector.unregister(child.replies)
        answers.append((child, child.give_up()))
    return answers
