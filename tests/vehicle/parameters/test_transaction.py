"""Writing as a transaction: proven, or undone, or with the way back in hand."""

from __future__ import annotations

import errno
import json
import math
import os
import random
import re
import shlex
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from parameter_vehicle import SYSTEM, ParameterVehicle, PX4Vehicle, Radio, ardupilot_parameters

from mavcompass.correction import FieldCorrection
from mavcompass.enums import MavCmd
from mavcompass.errors import LinkError, MavCompassError, Refused, WriteFailed
from mavcompass.messages import Message, ParamRequestRead, ParamSet, ParamValue
from mavcompass.printable import counted
from mavcompass.procedure.dialect import Change, ParameterPlan
from mavcompass.procedure.nameplate import Nameplate
from mavcompass.vehicle.dialects import CompassDialect, make_dialect
from mavcompass.vehicle.parameters.files import read_parameter_file
from mavcompass.vehicle.parameters.transaction import _sentence
from mavcompass.vehicle.parameters.undo import load_record, newest_record, undo_directory, undo_saver

SOURCE = "udpin:0.0.0.0:14550"
NEW = FieldCorrection((120.0, -80.0, 40.0), (1.1, 0.9, 1.0), (0.02, -0.01, 0.005), 1.02)


@pytest.fixture(autouse=True)
def flushed(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """Note what is flushed to the disk without waiting for it, hundreds of times over."""
    flushed: list[int] = []
    monkeypatch.setattr(os, "fsync", flushed.append)
    return flushed


def plan_for(
    vehicle: ParameterVehicle, correction: FieldCorrection = NEW, instance: int = 1
) -> ParameterPlan:
    dialect = make_dialect(_autopilot(vehicle), SOURCE)
    held = {name: value for name, value in vehicle.values.items()}
    plan = dialect.plan(held, {instance: correction})
    assert plan.changes and not plan.refusals
    return plan


def write(radio: Radio, plan: ParameterPlan, folder: Path):
    saver = undo_saver(SOURCE, folder)
    return radio.run(lambda context: introduced(radio.vehicle).write(context, plan, saver))


def introduced(vehicle: ParameterVehicle) -> CompassDialect:
    """Give a dialect that knows whom it talks to."""
    dialect = make_dialect(_autopilot(vehicle), SOURCE)
    dialect._nameplate = Nameplate(dialect.autopilot, SYSTEM, "0a")
    return dialect


def restore(radio: Radio, undo_file: Path, folder: Path):
    """Do what `mavcompass params restore` does."""
    dialect = make_dialect(_autopilot(radio.vehicle), SOURCE)
    before = dict(load_record(undo_file).before)
    held = radio.run(lambda context: dialect.read_parameters(context, [*before]))
    return write(radio, dialect.plan_values(held, before, checked=False), folder)


def _autopilot(vehicle: ParameterVehicle) -> str:
    return "px4" if isinstance(vehicle, PX4Vehicle) else "ardupilot"


@pytest.mark.parametrize("kind", [ParameterVehicle, PX4Vehicle])
def test_a_plan_is_written_and_read_back(kind: type[ParameterVehicle], tmp_path: Path) -> None:
    vehicle = kind()
    before = dict(vehicle.values)
    outcome = write(Radio(vehicle), plan_for(vehicle), tmp_path)
    assert outcome.verified
    dialect = make_dialect(_autopilot(vehicle))
    in_force = dialect.correction(vehicle.values, 1)
    # 32-bit floats on the vehicle, and on PX4 in gauss
    assert in_force.offsets_mgauss == pytest.approx(NEW.offsets_mgauss, abs=1e-4)
    assert in_force.matrix == pytest.approx(NEW.matrix, abs=1e-6)
    changed = {name for name in before if vehicle.values[name] != before[name]}
    assert changed == set(outcome.values)
    restore(Radio(vehicle), outcome.undo_file, tmp_path)
    assert vehicle.values == before


def test_the_undo_file_is_on_disk_before_the_first_write(tmp_path: Path, flushed: list[int]) -> None:
    vehicle = ParameterVehicle()
    seen: list[tuple[int, int, int]] = []
    original = vehicle.set

    def spying_set(message: ParamSet):
        (undo_file,) = tmp_path.glob("*.json")
        seen.append((len(load_record(undo_file).before), len(list(tmp_path.iterdir())), len(flushed)))
        return original(message)

    vehicle.set = spying_set  # type: ignore[method-assign]
    plan = plan_for(vehicle)
    write(Radio(vehicle), plan, tmp_path)
    # all three files whole, each flushed itself and in its folder
    assert seen and set(seen) == {(len(plan.changes), 3, 6)}


def test_the_undo_file_tells_all_and_other_tools_can_load_it(tmp_path: Path) -> None:
    vehicle = ParameterVehicle()
    outcome = write(Radio(vehicle), plan_for(vehicle), tmp_path)
    document = json.loads(outcome.undo_file.read_text())
    assert document["schema"] == "mavcompass.undo/1"
    assert document["source"] == SOURCE
    assert document["before"]["COMPASS_OFS_X"] == 5.0
    assert document["planned"]["COMPASS_OFS_X"] == 120.0
    assert read_parameter_file(outcome.undo_file.with_suffix(".param")) == document["before"]
    assert read_parameter_file(outcome.undo_file.with_suffix(".new.param")) == document["planned"]
    assert f"params write {SOURCE} {outcome.undo_file.with_suffix('.new.param')}" in outcome.again_command
    assert not list(tmp_path.glob("*.part"))
    assert newest_record(Nameplate("ardupilot", SYSTEM, "0a"), tmp_path) == outcome.undo_file
    assert newest_record(Nameplate("ardupilot", SYSTEM, "0b"), tmp_path) is None
    assert newest_record(None, tmp_path) is None
    modes = {path.stat().st_mode & 0o777 for path in tmp_path.iterdir()}
    assert modes == {0o600}


def test_undo_files_are_counted_whatever_the_clock_says(tmp_path: Path) -> None:
    years = iter((2026, 2026, 1970, 2031, 1970))
    saver = undo_saver(SOURCE, tmp_path, utc_now=lambda: datetime(next(years), 5, 4, 3, 2, 1, tzinfo=UTC))
    plan, plate = ParameterPlan((Change("COMPASS_OFS_X", 1.0, 2.0),)), Nameplate("ardupilot", 1, "0a")
    made = [saver(plan, {}, plate) for _ in range(4)]
    assert len(set(made)) == 4 and sorted(made) == made
    assert newest_record(plate, tmp_path) == made[-1]
    saver(plan, {}, Nameplate("ardupilot", 2, "0b"))
    assert newest_record(plate, tmp_path) == made[-1]


@pytest.mark.parametrize("fits", [0, 1, 2])
def test_a_full_disk_leaves_nothing_behind_and_nothing_is_sent(
    fits: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(handle: int) -> None:
        nonlocal fits
        fits -= 1
        if fits < 0:
            raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", full)
    fits *= 2  # a file, and its name in the folder
    vehicle = ParameterVehicle()
    with pytest.raises(WriteFailed, match="No space left"):
        write(Radio(vehicle), plan_for(vehicle), tmp_path / "undo")
    assert not vehicle.writes and not list((tmp_path / "undo").iterdir())
    assert (tmp_path / "undo").stat().st_mode & 0o777 == 0o700


def test_the_undo_directory_follows_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", "/state")
    assert undo_directory() == Path("/state/mavcompass/undo")
    monkeypatch.setenv("MAVCOMPASS_UNDO_DIR", "/elsewhere")
    assert undo_directory() == Path("/elsewhere")


def test_no_room_for_the_undo_file_means_nothing_is_written(tmp_path: Path) -> None:
    (tmp_path / "undo").write_text("a file where the folder should be")
    vehicle = ParameterVehicle()
    radio = Radio(vehicle)
    with pytest.raises(WriteFailed, match="nothing was sent") as failed:
        write(radio, plan_for(vehicle), tmp_path / "undo")
    assert "MAVCOMPASS_UNDO_DIR" in failed.value.remedy
    assert not vehicle.writes


def test_a_plan_that_changes_nothing_sends_nothing(tmp_path: Path) -> None:
    radio = Radio(ParameterVehicle())
    outcome = write(radio, ParameterPlan(()), tmp_path)
    assert outcome.verified and outcome.undo_file is None
    assert not radio.sent and not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("new", "refusals", "why"),
    [*((value, (), "not a number") for value in (math.nan, math.inf, -math.inf, 1e39)),
     (6.0, ("The vehicle says no.",), "says no")],
)  # fmt: skip
def test_what_is_refused_or_no_number_is_so_before_anything_is_sent(
    new: float, refusals: tuple[str, ...], why: str, tmp_path: Path
) -> None:
    radio = Radio(ParameterVehicle())
    with pytest.raises(Refused, match=why):
        write(radio, ParameterPlan((Change("COMPASS_OFS_X", 5.0, new),), refusals=refusals), tmp_path)
    assert not radio.sent and not list(tmp_path.iterdir())


def test_values_that_moved_since_the_plan_are_not_overwritten(tmp_path: Path) -> None:
    vehicle = ParameterVehicle()
    plan = plan_for(vehicle)
    vehicle.values["COMPASS_OFS_Y"] = 99.0
    with pytest.raises(WriteFailed, match="COMPASS_OFS_Y is 99 now and was 13"):
        write(Radio(vehicle), plan, tmp_path)
    assert not vehicle.writes and not list(tmp_path.iterdir())


def test_what_does_not_answer_though_it_exists_is_asked_for_long_and_nothing_is_written(
    tmp_path: Path,
) -> None:
    vehicle = ParameterVehicle()
    vehicle.deaf.add("COMPASS_OFS_Y")
    radio = Radio(vehicle)
    with pytest.raises(WriteFailed, match="does not answer for COMPASS_OFS_Y"):
        write(radio, plan_for(vehicle), tmp_path)
    asked = [m for m in radio.sent if isinstance(m, ParamRequestRead) and m.param_id == "COMPASS_OFS_Y"]
    assert len(asked) == 25 and not vehicle.writes and not list(tmp_path.iterdir())


def test_a_refused_value_undoes_all_that_was_written(tmp_path: Path) -> None:
    vehicle = ParameterVehicle()
    before = dict(vehicle.values)
    vehicle.stuck.add("COMPASS_DIA_Y")
    with pytest.raises(WriteFailed, match=r"COMPASS_DIA_Y.*put back") as failed:
        write(Radio(vehicle), plan_for(vehicle), tmp_path)
    assert vehicle.values == before
    assert failed.value.undo_file is not None and not failed.value.restore_command


def test_a_stop_in_the_middle_undoes_and_stays_a_stop(tmp_path: Path) -> None:
    moments = 0
    for stop_s in (0.1, 0.2, 0.3, 0.45):
        vehicle = ParameterVehicle()
        before = dict(vehicle.values)
        radio = Radio(vehicle, stop_s=stop_s)
        with pytest.raises(Refused, match=r"Stopped\."):
            write(radio, plan_for(vehicle), tmp_path)
        assert vehicle.values == before
        moments += bool(vehicle.writes)
    assert moments >= 2, "no stop came after the first write"


def test_a_stop_during_the_undo_does_not_stop_the_undo(tmp_path: Path) -> None:
    vehicle = ParameterVehicle()
    before = dict(vehicle.values)
    vehicle.stuck.add("COMPASS_DIA_Y")
    radio = Radio(vehicle)
    with pytest.raises(WriteFailed):
        write(radio, plan_for(vehicle), tmp_path)
    undo_began_s = next(
        t
        for m, t in zip(radio.sent, radio.sent_s, strict=True)
        if isinstance(m, ParamSet) and m.param_value == -18.0
    )
    again = ParameterVehicle()
    again.stuck.add("COMPASS_DIA_Y")
    with pytest.raises(WriteFailed, match="put back"):
        write(Radio(again, stop_s=undo_began_s + 0.01), plan_for(again), tmp_path)
    assert again.values == before


def test_a_procedure_that_is_ended_says_what_it_leaves(tmp_path: Path) -> None:
    """The clean-up time runs out while the vehicle keeps talking but takes nothing."""
    vehicle = ParameterVehicle()
    plan = plan_for(vehicle)
    original = vehicle.handle

    def goes_mute(message):
        answers = original(message)
        vehicle.mute = vehicle.mute or len(vehicle.writes) >= 3
        return answers

    vehicle.handle = goes_mute  # type: ignore[method-assign]
    with pytest.raises(WriteFailed) as failed:
        write(Radio(vehicle, stop_s=0.5), plan, tmp_path)
    assert failed.value.restore_command.startswith("mavcompass params restore")


@pytest.mark.parametrize("seed", range(8))
def test_a_bad_radio_only_makes_it_slower(seed: int, tmp_path: Path) -> None:
    vehicle = ParameterVehicle()
    radio = Radio(vehicle, seed=seed, loss=0.3, duplication=0.05, delay_s=0.3, jitter_s=0.2, silence_s=12.0)
    plan = plan_for(vehicle)
    outcome = write(radio, plan, tmp_path)
    assert outcome.verified
    assert all(vehicle.values[c.name] == pytest.approx(c.new, rel=1e-6) for c in plan.changes)


@pytest.mark.parametrize("kind", [ParameterVehicle, PX4Vehicle])
def test_200_cut_links_never_leave_a_torn_set_without_the_way_back(
    kind: type[ParameterVehicle], tmp_path: Path
) -> None:
    chance = random.Random(20261121)
    torn = finished = untouched = 0
    for run in range(200):
        vehicle = kind()
        before = dict(vehicle.values)
        plan = plan_for(vehicle)
        folder = tmp_path / str(run)
        loss = chance.choice([0.0, 0.1, 0.3])
        radio = Radio(vehicle, seed=run, loss=loss, jitter_s=0.05, cut_s=chance.uniform(0.0, 3.0))
        error: MavCompassError | None = None
        try:
            write(radio, plan, folder)
        except MavCompassError as raised:
            error = raised
        state = {c.name: vehicle.values[c.name] for c in plan.changes}
        wanted = {c.name for c in plan.changes if state[c.name] == pytest.approx(c.new, rel=1e-6)}
        if error is None:
            assert len(wanted) == len(plan.changes)
            finished += 1
            continue
        if vehicle.values == before:
            untouched += 1
            assert isinstance(error, WriteFailed | Refused | LinkError)
            continue
        assert isinstance(error, WriteFailed), f"run {run}: {error!r} with {sorted(wanted)} written"
        torn += 1
        _put_back_by_its_command(error, vehicle, folder)
        assert vehicle.values == before, f"run {run}"
    assert torn > 50 and finished > 5 and untouched > 20, (torn, finished, untouched)


def _put_back_by_its_command(error: WriteFailed, vehicle: ParameterVehicle, folder: Path) -> None:
    """Follow the sentence that the person sees, letter by letter, once the link is back."""
    assert error.undo_file is not None and error.undo_file.exists()
    assert error.restore_command in str(error)
    program, command, verb, source, file, *_ = shlex.split(error.restore_command)
    assert (program, command, verb, source) == ("mavcompass", "params", "restore", SOURCE)
    assert Path(file) == error.undo_file
    restore(Radio(vehicle), Path(file), folder)


def test_a_link_that_comes_back_in_time_is_undone_by_itself(tmp_path: Path) -> None:
    vehicle = ParameterVehicle()
    before = dict(vehicle.values)
    plan = plan_for(vehicle)
    original = vehicle.handle
    calls = 0

    def deaf_for_a_while(message):
        nonlocal calls
        calls += isinstance(message, ParamSet)
        return original(message) if not 4 <= calls < 12 else []

    vehicle.handle = deaf_for_a_while  # type: ignore[method-assign]
    radio = Radio(vehicle, stop_s=0.3)
    with pytest.raises(Refused):
        write(radio, plan, tmp_path)
    assert vehicle.values == before


class ForgetfulVehicle(ParameterVehicle):
    """Echo some writes without storing them, as a late echo of an older write looks."""

    def __init__(self, forgets: int) -> None:
        super().__init__()
        self.forgets = forgets

    def set(self, message: ParamSet) -> list[Message]:
        if message.param_id == "COMPASS_OFS_Y" and message.param_value == -80.0 and self.forgets > 0:
            self.forgets -= 1
            return [ParamValue(message.param_id, message.param_value)]
        return super().set(message)


def test_a_late_echo_cannot_vouch_for_a_lost_write(tmp_path: Path) -> None:
    vehicle = ForgetfulVehicle(forgets=2)
    outcome = write(Radio(vehicle), plan_for(vehicle), tmp_path)
    assert outcome.verified and vehicle.values["COMPASS_OFS_Y"] == -80.0


def test_a_value_that_never_reads_back_is_undone(tmp_path: Path) -> None:
    vehicle = ForgetfulVehicle(forgets=10**6)
    before = dict(vehicle.values)
    with pytest.raises(WriteFailed, match="keeps COMPASS_OFS_Y at 13 instead of -80"):
        write(Radio(vehicle), plan_for(vehicle), tmp_path)
    assert vehicle.values == before


@pytest.mark.parametrize("seed", range(6))
def test_a_stop_on_a_bad_radio_leaves_the_vehicle_as_before(seed: int, tmp_path: Path) -> None:
    vehicle = ParameterVehicle()
    before = dict(vehicle.values)
    radio = Radio(
        vehicle, seed=seed, loss=0.2, duplication=0.05, delay_s=0.1, jitter_s=0.2, silence_s=12.0, stop_s=3.0
    )
    with pytest.raises(Refused, match="Stopped"):
        write(radio, plan_for(vehicle), tmp_path)
    assert vehicle.writes and vehicle.values == before


corrections = st.builds(
    FieldCorrection,
    st.tuples(*[st.floats(-390, 390)] * 3).filter(lambda v: max(map(abs, v)) > 0.1),
    st.tuples(*[st.floats(0.6, 1.6)] * 3),
    st.tuples(*[st.floats(-0.1, 0.1)] * 3),
    st.floats(0.7, 1.4),
)


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(corrections, st.integers(1, 2), st.sampled_from([ParameterVehicle, PX4Vehicle]))
def test_writing_and_undoing_leaves_the_vehicle_as_before(
    tmp_path: Path, correction: FieldCorrection, instance: int, kind: type[ParameterVehicle]
) -> None:
    vehicle = kind()
    before = dict(vehicle.values)
    plan = plan_for(vehicle, correction, instance)
    outcome = write(Radio(vehicle), plan, tmp_path)
    assert vehicle.values != before
    assert outcome.undo_file is not None and outcome.undo_file.exists()
    Radio(vehicle).run(lambda context: outcome.take_back(context, "Not proven."))
    # All is as it was before, and nothing is left that `params restore` would take for the last write.
    assert vehicle.values == before and not outcome.undo_file.exists()


# --- the device id ------------------------------------------------------------------------------


def never_calibrated() -> ParameterVehicle:
    vehicle = ParameterVehicle(ardupilot_parameters(COMPASS_OFS_X=0.0, COMPASS_OFS_Y=0.0, COMPASS_OFS_Z=0.0))
    vehicle.stored_ids = {2, 3}
    return vehicle


def test_a_compass_never_calibrated_has_its_device_id_stored(tmp_path: Path) -> None:
    vehicle = never_calibrated()
    plan = plan_for(vehicle)
    assert plan.commit_instances == (1,)
    outcome = write(Radio(vehicle), plan, tmp_path)
    assert vehicle.calibrated() and not outcome.remarks
    # Storing it is telling the offsets that were written once more.
    (told,) = (c for c in vehicle.commands if c.command == MavCmd.PREFLIGHT_SET_SENSOR_OFFSETS)
    assert (told.param2, told.param3, told.param4) == NEW.offsets_mgauss
    assert vehicle.values["COMPASS_OFS2_X"] == 5.0  # the other compass as it was


def test_an_exchanged_compass_is_found_by_the_arming_checks(tmp_path: Path) -> None:
    vehicle = ParameterVehicle()
    vehicle.stored_ids = {2, 3}
    plan = plan_for(vehicle, FieldCorrection((5.5, 13.0, -18.0)))
    assert not plan.commit_instances and len(plan.changes) == 1
    outcome = write(Radio(vehicle), plan, tmp_path)
    assert vehicle.calibrated() and outcome.verified


def test_the_device_id_is_left_alone_where_the_firmware_is_content(tmp_path: Path) -> None:
    vehicle = ParameterVehicle()
    write(Radio(vehicle), plan_for(vehicle), tmp_path)
    assert {c.command for c in vehicle.commands} == {MavCmd.RUN_PREARM_CHECKS}


@pytest.mark.parametrize(
    ("change", "asked"),
    [
        (Change("COMPASS_DIA_X", 1.0, 1.1), set()),
        (Change("COMPASS_OFS_X", 9.0, 0.0), {MavCmd.RUN_PREARM_CHECKS}),
    ],
)
def test_what_is_no_offset_has_no_device_id_stored(
    change: Change, asked: set[MavCmd], tmp_path: Path
) -> None:
    vehicle = never_calibrated()
    vehicle.values[change.name] = change.old
    assert write(Radio(vehicle), ParameterPlan((change,)), tmp_path).remarks == ()
    assert {command.command for command in vehicle.commands} == asked


def test_a_build_without_sensor_offsets_gets_the_other_command_and_the_person_is_told(tmp_path: Path) -> None:
    vehicle = never_calibrated()
    vehicle.known_commands = {MavCmd.PREFLIGHT_CALIBRATION, MavCmd.RUN_PREARM_CHECKS}
    outcome = write(Radio(vehicle), plan_for(vehicle), tmp_path)
    assert vehicle.calibrated()
    assert re.search("All detected compasses", " ".join(outcome.remarks))


@pytest.mark.parametrize("refuses", [True, False])
def test_a_build_with_neither_command_is_told_about(refuses: bool, tmp_path: Path) -> None:
    vehicle = never_calibrated()
    vehicle.known_commands, answers = {MavCmd.RUN_PREARM_CHECKS}, vehicle.command
    if not refuses:  # it says nothing
        vehicle.command = lambda m: answers(m) if m.command in vehicle.known_commands else []  # type: ignore[method-assign]
    outcome = write(Radio(vehicle), plan_for(vehicle), tmp_path)
    assert outcome.verified and len(outcome.remarks) == 2
    assert "would not store" in outcome.remarks[0] and "still says" in outcome.remarks[1]


def test_an_armed_vehicle_is_not_asked_for_arming_checks_in_vain(tmp_path: Path) -> None:
    vehicle = ParameterVehicle()
    vehicle.armed = True
    radio = Radio(vehicle)
    outcome = write(radio, plan_for(vehicle), tmp_path)
    assert outcome.verified and not outcome.remarks
    assert radio.now_s < 1.5


class ContradictingVehicle(ParameterVehicle):
    """Says much unasked, and answers everything twice: with an odd value first, then with the right one."""

    def __init__(self, odd: float | None, unasked: int = 0) -> None:
        super().__init__()
        self.odd, self.unasked = odd, unasked

    def handle(self, message: Message) -> list[Message]:
        right = super().handle(message)
        values = [m for m in right if isinstance(m, ParamValue)]
        odd = [] if self.odd is None else [replace(m, param_value=self.odd) for m in values]
        return [*odd, *(ParamValue(f"X{k}", math.nan, 9, 10_000, k) for k in range(self.unasked)), *right]


@pytest.mark.parametrize("odd", [math.nan, math.inf, -math.inf, 1e30, 0.0])
def test_contradictory_echoes_are_written_through_or_undone(odd: float, tmp_path: Path) -> None:
    vehicle = ContradictingVehicle(odd)
    plan, before = plan_for(vehicle), dict(vehicle.values)
    try:
        outcome = write(Radio(vehicle), plan, tmp_path)
    except WriteFailed as error:
        assert vehicle.values == before or error.restore_command
    else:
        assert outcome.verified
        assert all(vehicle.values[change.name] == pytest.approx(change.new) for change in plan.changes)


def test_ten_thousand_parameters_that_nobody_asked_for_do_no_harm(tmp_path: Path) -> None:
    vehicle = ContradictingVehicle(None, unasked=400)
    radio = Radio(vehicle)
    assert write(radio, plan_for(vehicle), tmp_path).verified
    assert len(radio.sent) * 400 > 10_000


@pytest.mark.parametrize(
    ("error", "sentence"),
    [
        (Refused("It was stopped.", "Wait."), "It was stopped."),
        (ZeroDivisionError("by zero"), "ZeroDivisionError: by zero"),
    ],
)
def test_why_it_was_put_back_is_a_sentence_or_the_fault(error: Exception, sentence: str) -> None:
    assert _sentence(error) == sentence


def test_parameters_are_counted_as_people_do() -> None:
    assert [counted(n, "parameter") for n in (0, 1, 2)] == ["0 parameters", "1 parameter", "2 parameters"]
