"""A request on its way: what is told of it, its question and answer, its end; one at a time."""

from __future__ import annotations

import pytest

from mavcompass.errors import Refused
from mavcompass.heading.live import Heading
from mavcompass.procedure.script import Ask, Show
from mavcompass.service.work.tasks import Busy, CheckRequest, Desk, Task


def task() -> Task:
    return Task(1, CheckRequest(), "http", "2026-05-01T00:00:00+00:00")


def test_the_fraction_never_falls_and_a_write_is_not_the_whole() -> None:
    one = task()
    shown = []
    for step, fraction in (("a", 0.3), ("a", 0.2), ("a", None), ("write", 1.0), ("b", 1.0)):
        one.show(Show(step, "x", fraction))
        shown.append(one.fraction)
    assert shown == [0.3, 0.3, 0.3, 0.9, 1.0]
    assert [line["fraction"] for line in one.lines] == shown


def test_of_many_lines_the_latest_stays() -> None:
    one = task()
    for k in range(203):
        one.show(Show("turn", f"{k}", None, (("turned_deg", float(k)),)))
    assert len(one.lines) == 200
    assert [one.lines[k]["text"] for k in (0, 198, 199)] == ["0", "198", "202"]
    assert one.lines[-1]["data"] == {"turned_deg": 202.0}


@pytest.mark.parametrize("yes", [True, False])
def test_a_question_is_answered_once(yes: bool) -> None:
    one = task()
    assert not one.give_answer(yes) and one.poll_answer() is None
    one.ask(Ask("Write?"))
    assert (one.state, one.question) == ("asking", Ask("Write?")) and one.poll_answer() is None
    assert one.give_answer(yes) and not one.give_answer(not yes), "a second answer is too late"
    assert one.poll_answer() is yes
    assert (one.state, one.question) == ("running", None) and one.poll_answer() is None
    one.give_answer(True)
    one.ask(Ask("Again?"))
    assert one.poll_answer() is None, "an old answer is none to a new question"


def test_who_joins_late_sees_the_whole_run() -> None:
    one = task()

    def turned_to(forward: float, turned_rad: float = 0.0) -> None:
        one.trail.add(Heading(0.0, 0.0, 2, 0.0, None, 0.1, (forward, 5.0, 400.0)), turned_rad)

    for forward in (100.0, 101.0, 150.0):
        turned_to(forward, turned_rad=1.0)
    one.show(Show("dwell", "", None, (("position", 1.0),)))
    early = one.trail.since({})
    one.show(Show("write", ""))
    turned_to(200.0)
    late, more = one.trail.since({}), one.trail.since({2: 2})
    assert early["compasses"][2]["points"] == [(100.0, 5.0), (150.0, 5.0)]
    assert late["compasses"][2] == {
        "first": 0,
        "points": [(100.0, 5.0), (150.0, 5.0), (200.0, 5.0)],
        "positions": [(150.0, 5.0)],
        "written": 2,
    }
    assert (more["compasses"][2]["first"], more["compasses"][2]["points"]) == (2, [(200.0, 5.0)])
    assert late["turned_at_start_deg"] == 57.3


def test_a_run_is_drawn_by_nine_hundred_points_none_nearer_to_the_last_than_three_halves() -> None:
    one = task()
    for step in range(4000):
        one.trail.add(Heading(0.0, 0.0, 1, 0.0, None, 0.1, (0.5 * step, 5.0, 400.0)), 0.0)
    assert one.trail.since({})["compasses"][1]["points"] == [(1.5 * k, 5.0) for k in range(900)]


def test_an_end_is_an_end() -> None:
    done, failed = task(), task()
    assert not done.finished
    done.ask(Ask("?"))
    done.finish(True, {"x": 1}, 4)
    assert done.finished and done.question is None and done.fraction == 1.0
    failed.fail(Refused("The pilot moved a stick.", "Let go."))
    assert failed.finished and (failed.error, failed.remedy) == ("The pilot moved a stick.", "Let go.")
    told = done.to_json()
    assert (told["state"], told["ok"], told["history_entry"], told["document"]) == ("done", True, 4, {"x": 1})


def test_a_desk_takes_one_thing_at_a_time_until_it_closes() -> None:
    desk = Desk()
    assert desk.current is None and not desk.busy and desk.take() is None
    first = desk.submit(CheckRequest(), "http", "now")
    assert desk.busy
    with pytest.raises(Busy, match="A check is under way"):
        desk.submit(CheckRequest(), "mavlink", "now")
    assert desk.take() is first and first.state == "running" and desk.take() is None
    first.finish(True, {}, None)
    assert not desk.busy
    second = desk.submit(CheckRequest(), "http", "now")
    assert (first.number, second.number) == (1, 2)
    desk.close("The service is stopping.")
    assert (second.state, second.error) == ("failed", "The service is stopping.")
    with pytest.raises(Refused, match="stopping"):
        desk.submit(CheckRequest(), "http", "now")
