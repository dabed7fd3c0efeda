"""What SECURITY.md promises of signed messages, promise by promise."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from pathlib import Path
from types import ModuleType

import pytest

from mavcompass.errors import UsageError
from mavcompass.messages import Attitude
from mavcompass.vehicle.wire import signing as signing_module
from mavcompass.vehicle.wire.framing import FrameWriter, split_frame
from mavcompass.vehicle.wire.signing import Signing

KEY = bytes(range(32))
NOW_S = 1_780_000_000.0
YEAR_S = 365.0 * 86_400.0


def ear(memory: Path | None = None, now_s: float = NOW_S) -> Signing:
    return Signing(KEY, clock=lambda: now_s, memory=memory)


def said(at_s: float, link: int = 0, system: int = 1) -> bytes:
    """Return a frame that was signed then."""
    return FrameWriter(signing=Signing(KEY, link, clock=lambda: at_s)).write(Attitude(), system, 1)


def hears(by: Signing, raw: bytes) -> bool:
    frame = split_frame(raw)
    return by.accepts(raw, frame.system, frame.component)


@pytest.fixture
def memory(tmp_path: Path) -> Path:
    return tmp_path / "stamps.json"


@pytest.mark.parametrize("stopped", [True, False])
@pytest.mark.parametrize("later_s", [NOW_S, NOW_S + 30.0, 0.0])
def test_what_was_believed_once_is_not_again_after_a_stop_or_a_kill_whatever_the_clock_says(
    stopped: bool, later_s: float, memory: Path
) -> None:
    first = ear(memory)
    frames = [said(NOW_S + at_s) for at_s in (0.0, 0.5, 1.9)]
    assert all(hears(first, raw) for raw in frames) and not any(hears(first, raw) for raw in frames)
    if stopped:
        first.keep()
    second = ear(memory, later_s)
    assert not any(hears(second, raw) for raw in frames)
    assert hears(second, said(NOW_S + 1.91)) is stopped  # a kill costs two seconds at most
    assert hears(second, said(NOW_S + 4.0))


def test_who_is_heard_for_the_first_time_must_be_of_the_last_minute() -> None:
    for system, (behind_s, believed) in enumerate(((YEAR_S, False), (61.0, False), (59.0, True)), 1):
        assert hears(ear(), said(NOW_S - behind_s, system=system)) is believed
    ahead = ear()
    assert hears(ahead, said(NOW_S + 100.0))  # the newest is what counts
    assert not hears(ahead, said(NOW_S + 39.0, system=2)) and hears(ahead, said(NOW_S + 41.0, system=3))


def test_a_stream_that_is_known_may_not_fall_a_minute_behind_either() -> None:
    late = ear()
    assert hears(late, said(NOW_S)) and hears(late, said(NOW_S + 61.0, system=2))
    assert not hears(late, said(NOW_S + 0.5)) and hears(late, said(NOW_S + 1.5))


def test_order_is_kept_per_sender_and_link_and_the_link_id_is_signed() -> None:
    by, links = ear(), {link: said(NOW_S + link, link) for link in (2, 1)}
    assert all(hears(by, raw) for raw in links.values())
    assert not hears(by, said(NOW_S + 1.5, 2))
    fresh = said(NOW_S + 5.0, 2)
    for link in (0, 1, 7):
        assert not hears(by, fresh[:-13] + bytes((link,)) + fresh[-12:])
    assert hears(by, fresh)


def test_our_own_stamps_go_on_over_a_restart_with_a_clock_set_back(memory: Path) -> None:
    def stamp(by: Signing) -> int:
        return int.from_bytes(by.sign(b"")[1:7], "little")

    first = stamp(ear(memory))
    assert stamp(ear(memory, 0.0)) > first
    theirs = ear(memory)
    assert hears(theirs, said(NOW_S + 500.0)) and stamp(theirs) > first + 499 * 100_000


def test_two_programs_hear_the_same_and_none_forgets_what_the_other_heard(memory: Path) -> None:
    one, two = ear(memory), ear(memory)
    frames = [said(NOW_S + at_s) for at_s in range(6)]
    assert all(hears(one, raw) and hears(two, raw) for raw in frames)
    other = said(NOW_S + 9.0, system=3)
    assert hears(one, other)
    one.keep()
    two.keep()
    assert not any(hears(ear(memory, NOW_S + 9.0), raw) for raw in (*frames, other))


def test_the_file_is_its_owners_and_holds_what_is_not_stale(memory: Path) -> None:
    by = ear(memory)
    for system in range(1, 200):
        assert hears(by, said(NOW_S + system, system=system))
    by.keep()
    assert memory.stat().st_mode & 0o777 == 0o600
    assert len(json.loads(memory.read_text())["streams"]) == 61


@pytest.mark.parametrize("damage", ["{", "[]", '{"newest": 1, "streams": {"1/2": 3}}', '{"newest": "x"}', ""])
def test_of_a_damaged_file_the_clock_is_left_to_judge(damage: str, memory: Path) -> None:
    memory.write_text(damage)
    by = ear(memory)
    assert not hears(by, said(NOW_S - YEAR_S)) and hears(by, said(NOW_S))


def test_where_stamps_cannot_be_kept_it_is_told_before_and_goes_on_after(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    key = tmp_path / "key"
    key.write_text(KEY.hex())
    monkeypatch.setenv("XDG_STATE_HOME", str(key))
    with pytest.raises(UsageError, match="cannot be kept in"):
        Signing.of_file(key)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    by = Signing.of_file(key)
    assert by.key == KEY and by.memory is not None
    # No name that tells the key, and the same after every update: what was heard before it stays heard.
    assert by.memory.name == "630dcd2966c43366.json"

    def full(*_: object, **__: object) -> None:
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(signing_module, "write_private", full)
    assert hears(by, said(by.clock() + 30.0)) and hears(by, said(by.clock() + 30.1))
    assert len([line for line in caplog.messages if "could not be kept" in line]) == 1


@pytest.fixture(scope="module")
def campaign(campaigns: Callable[[str], ModuleType]) -> ModuleType:
    return campaigns("replayed_signatures")


def test_of_frames_played_again_none_is_believed(
    campaign: ModuleType, capsys: pytest.CaptureFixture[str]
) -> None:
    assert campaign.main(["--frames", "2500", "--seed", "7"]) == 0, capsys.readouterr().out


@pytest.mark.parametrize("blunt", ["forgetful", "patient", "deaf to links"])
def test_the_campaign_notices(blunt: str, campaign: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    match blunt:
        case "forgetful":
            monkeypatch.setattr(Signing, "keep", lambda self, ahead=0: None)
        case "patient":
            monkeypatch.setattr(signing_module, "_MINUTE", 10**13)
        case "deaf to links":
            digest = Signing._digest
            monkeypatch.setattr(Signing, "_digest", lambda self, frame, head: digest(self, frame, head[1:]))
    assert campaign.main(["--frames", "2500", "--seed", "7"]) == 1
