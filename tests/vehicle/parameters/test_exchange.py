"""Many questions at once: how long each is waited for, how often it is asked, and when it is given up."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from mavcompass.errors import LinkLost
from mavcompass.messages import Heartbeat, Incoming, ParamRequestRead, ParamValue
from mavcompass.procedure.script import Context, Machine, Script, Send, Tick
from mavcompass.vehicle.parameters.protocol import WINDOW, Ask, Exchange

STEP_S = 0.01


def ask(name: str, **more: object) -> Ask:
    return Ask(name, (ParamRequestRead(param_id=name),), **more)  # type: ignore[arg-type]


def exchange(*asks: Ask) -> Exchange:
    return Exchange(Context(), "cast", asks)


def value(name: str, number: float = 1.0) -> ParamValue:
    return ParamValue(param_id=name, param_value=number, param_type=9)


Answers = Callable[[str, int], float | None]  # of a name and its try: after how long, None for never


def talked(
    asks: list[Ask], answers: Answers, longest_s: float = 120.0, alive: bool = True, silence_s: float = 5.0
) -> tuple[Machine[None], Exchange, list[tuple[float, str]]]:
    """Let a vehicle answer by a rule; it beats once a second where it is `alive`."""
    made: list[Exchange] = []

    def script(context: Context) -> Script[None]:
        made.append(Exchange(context, "cast", asks))
        yield from made[0].run(silence_s)

    machine, sent, due, tries = (
        Machine(script),
        list[tuple[float, str]](),
        list[tuple[float, str]](),
        dict[str, int](),
    )
    for k in range(round(longest_s / STEP_S)):
        now = STEP_S * k
        ready = sorted(d for d in due if d[0] <= now)
        event: Incoming | Tick = Tick(now)
        if ready:
            due.remove(ready[0])
            event = Incoming(now, 1, 1, value(ready[0][1]))
        elif alive and k % 100 == 50:
            event = Incoming(now, 1, 1, Heartbeat())
        for action in machine.step(event):
            if isinstance(action, Send) and isinstance(action.message, ParamRequestRead):
                name = action.message.param_id
                sent.append((now, name))
                tries[name] = tries.get(name, 0) + 1
                if (after_s := answers(name, tries[name])) is not None:
                    due.append((now + after_s, name))
        if machine.done:
            break
    return machine, made[0], sent


def test_no_more_than_a_dozen_are_under_way() -> None:
    names = [f"P{k:02}" for k in range(30)]
    machine, done, sent = talked([ask(n) for n in names], lambda name, k: 0.1)
    assert machine.done and machine.error is None and sorted(done.answers) == names
    assert [n for t, n in sent if t == 0.0] == names[:WINDOW] and WINDOW == 12
    assert [n for _, n in sent] == names  # each once, in order
    assert done.sent == 30 and done.answers["P07"].value == 1.0


def test_of_a_name_asked_twice_nobody_knows_which_was_answered() -> None:
    machine, done, sent = talked([ask("A")], lambda name, k: 0.1 if k == 3 else None)
    assert machine.done and done.round_trip_s is None and done.sent == 3
    # The first is waited for in full; the next as long as the share of answers lets hope.
    assert [t for t, _ in sent] == pytest.approx([0.0, 0.8, 0.8 + 0.8 * 0.75], abs=0.03)


def test_absent_names_are_told_from_lost_answers() -> None:
    names = [f"P{k:02}" for k in range(20)]
    machine, done, sent = talked(
        [ask(n) for n in [*names, "ABSENT"]], lambda n, k: None if n == "ABSENT" else 0.05
    )
    assert machine.done and machine.error is None and "ABSENT" not in done.answers and len(done.answers) == 20
    assert 4 <= sum(n == "ABSENT" for _, n in sent) <= 6
    _, lossy, _ = talked([ask(n) for n in names], lambda n, k: 0.05 if (hash_of(n) + k) % 2 else None)
    assert len(lossy.answers) == 20  # where half is lost, what exists is found


def hash_of(name: str) -> int:
    return sum(map(ord, name))


def test_a_vehicle_that_says_nothing_is_lost_and_nothing_counts_as_absent() -> None:
    machine, done, sent = talked([ask("A"), ask("B")], lambda name, k: None, alive=False, silence_s=4.0)
    assert isinstance(machine.error, LinkLost) and "silent for 4 s" in machine.error.what
    assert set(done.open) == {"A", "B"}
    assert max(t for t, _ in sent) <= 4.0


def test_enough_answers_end_it() -> None:
    def script(context: Context) -> Script[None]:
        yield from Exchange(context, "cast", [ask("A"), ask("B")]).run(5.0, lambda answers: "A" in answers)

    machine = Machine(script)
    machine.step(Tick(0.0))
    machine.step(Incoming(0.1, 1, 1, value("A")))
    assert machine.done and machine.error is None
