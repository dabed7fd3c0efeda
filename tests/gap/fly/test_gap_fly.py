"""`gap fly` with a program that speaks as ArduPilot's simulator does, the embedded firmware inside."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from contextlib import ExitStack, closing
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from mavcompass.cli.gap import command
from mavcompass.errors import BadRecording, Refused, UsageError
from mavcompass.logs import TlogWriter, read_track
from mavcompass.procedure.flying import Profile, profile_of
from mavcompass.track import MagSeries, Series, Track
from mavcompass.vehicle.flying import fly_in_simulator
from mavcompass.vehicle.simulators import ArduPilotSitl, Flight, px4, simulator_of

FAKE = Path(__file__).with_name("sitl_of_ours.py")
HIDDEN = {"SIM_MAG1_OFS_X": -60.0, "SIM_MAG1_OFS_Y": 35.0, "SIM_MAG1_OFS_Z": -20.0, "COMPASS_OFS_X": -5.0}
SPEED = 20.0


def bends(seconds: float = 24.0, kind: str = "rover") -> Profile:
    """Drive bends to both sides at a walking pace."""
    time_s = np.arange(0.0, seconds, 0.1)
    rate = np.where((time_s // 10.0) % 2 == 0, 0.5, -0.35)
    yaw = np.cumsum(rate) * 0.1
    velocity = np.column_stack([np.cos(yaw), np.sin(yaw), np.zeros(time_s.size)])
    place = np.cumsum(velocity, axis=0) * 0.1
    return Profile(kind, time_s, yaw, rate, velocity, place, (47.4, 8.5, 500.0), 20.0, 1.8e9)


@pytest.fixture(scope="module")
def sitl(tmp_path_factory: pytest.TempPathFactory) -> Path:
    program = tmp_path_factory.mktemp("sitl") / "ardurover"
    program.write_text(f"#!{sys.executable}\n{FAKE.read_text()}")
    program.chmod(0o755)
    return program


def fly(sitl: ArduPilotSitl, folder: Path, parameters: dict[str, float], profile: Profile) -> Path:
    tlog = folder / "flown.tlog"
    with TlogWriter(tlog) as writer:
        fly_in_simulator(sitl, profile, parameters, folder, writer.append)
    return tlog


def is_gone(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return True
    return False


def test_the_simulator_is_made_like_the_vehicle_and_shows_it(sitl: Path, tmp_path: Path) -> None:
    real = fly(ArduPilotSitl(sitl, speed=SPEED), tmp_path, HIDDEN, bends())
    assert is_gone(int((tmp_path / "pid").read_text())), "the simulator is left running"
    track = read_track(real)
    assert track.vehicle == "rover" and track.parameters["COMPASS_OFS_X"] == -5.0
    recorded = real.read_bytes()
    assert track.utc_offset_s is not None and 0.0 < int.from_bytes(recorded[:8], "big") - 1.8e15 < 6e7
    assert recorded.find(b"COMPASS_OFS_X") < 0.1 * len(recorded), "the parameters come first"
    assert track.compasses[1].in_force[-1].correction.offsets_mgauss[0] == -5.0
    flown, asked = profile_of(track), bends()
    assert flown.rate_hz == pytest.approx(20.0, rel=0.05)
    both = slice(min(flown.yaw_rad.size, asked.yaw_rad.size))
    turned = np.degrees(flown.yaw_rad[both] - asked.yaw_rad[both])
    assert np.std(turned) < 8.0 and np.mean(flown.forward_mps) == pytest.approx(1.0, abs=0.1)

    kept, out, page = tmp_path / "kept", tmp_path / "fly.json", tmp_path / "fly.html"
    words = ["fly", str(real), "--sitl", str(sitl), "--speed", str(SPEED), "--keep", str(kept)]
    run = CliRunner().invoke(command, [*words, "--json", str(out), "--report", str(page)])
    assert run.exit_code == 0, run.output
    assert "the gap closed as promised" in run.output and "the simulator lacks hard_iron" in run.output
    document = json.loads(out.read_text())
    exported = document["export"]["parameters"]
    for name in ("SIM_MAG1_OFS_X", "SIM_MAG1_OFS_Y", "SIM_MAG1_OFS_Z"):
        assert exported[name] == pytest.approx(HIDDEN[name], abs=2.0)
    assert document["promised"]["shrink"] > 0.95 and document["achieved"]["shrink"] > 0.95
    assert {path.name for path in kept.iterdir()} == {"found.parm", "simulator.tlog", "simulator_again.tlog"}
    plain = read_track(kept / "simulator.tlog").parameters
    assert plain["COMPASS_OFS_X"] == -5.0, "the simulator is flown with the calibration of the vehicle"
    assert page.stat().st_size > 10_000

    wrong = tmp_path / "wrong.parm"
    wrong.write_text("SIM_MAG1_OFS_X 60\nSIM_MAG1_OFS_Y 35\nSIM_MAG1_OFS_Z -20\n")
    again = [*words[:-1], str(tmp_path / "again"), "--simulator", str(kept / "simulator.tlog")]
    run = CliRunner().invoke(command, [*again, "--export", str(wrong)])
    assert run.exit_code == 0 and "less than promised" in run.output, run.output


def test_what_ends_or_is_of_another_kind_is_said_and_nothing_is_left(sitl: Path, tmp_path: Path) -> None:
    rover = ArduPilotSitl(sitl, "rover", speed=SPEED)
    with pytest.raises(UsageError, match=r"ended by itself. It said: .*no such frame"):
        fly(rover, tmp_path, {"SIM_TEST_DIES": 1.0}, bends())
    with pytest.raises(Refused, match="flies a rover, the recording is of a copter"):
        fly(rover, tmp_path, {"SIM_MAG1_OFS_X": 1.0}, bends(kind="copter"))
    assert is_gone(int((tmp_path / "pid").read_text()))


@pytest.mark.parametrize(
    ("program", "said"),
    [
        (None, "There is no program"),
        ("#!/bin/sh\necho usage\n", "is not ArduPilot's simulator"),
        ("", "is not a program that may be run"),
        ("\x7fELF", "could not be started"),
    ],
)
def test_a_program_that_is_none_is_refused_before_anything_is_read(
    program: str | None, said: str, tmp_path: Path
) -> None:
    file, log = tmp_path / "arducopter", tmp_path / "empty.tlog"
    log.touch()
    if program is not None:
        file.write_text(program)
        file.chmod(0o755 if program else 0o644)
    run = CliRunner().invoke(command, ["fly", str(log), "--sitl", str(file)])
    assert isinstance(run.exception, UsageError) and said in str(run.exception)
    assert run.exception.remedy


def still(track: Track, **columns: object) -> Track:
    return Track(**{name: getattr(track, name) for name in Track.__slots__} | columns)  # type: ignore[arg-type]


def test_a_recording_whose_motion_is_not_known_is_refused() -> None:
    time_s = np.arange(0.0, 30.0, 0.1)
    compass = MagSeries(1, Series.of(time_s, np.full((300, 3), 200.0)))
    attitude = Series.of(time_s, np.column_stack([0.0 * time_s, 0.0 * time_s, 3.0 + 0.02 * time_s]))
    whole = Track(vehicle="copter", compasses={1: compass}, attitude_rad=attitude)
    profile = profile_of(whole, longest_s=20.0)
    assert profile.duration_s == pytest.approx(19.9) and not profile.pivots and profile.home is None
    assert np.allclose(profile.yaw_rate_radps[5:-5], 0.02)
    assert np.all(profile.position_m[:, 2] <= -2.0), "a copter is never asked to fly through the ground"
    with pytest.raises(BadRecording, match="tells no attitude"):
        profile_of(still(whole, attitude_rad=None))
    with pytest.raises(BadRecording, match="tells no compass 2"):
        profile_of(whole, 2)
    with pytest.raises(BadRecording, match="kind 'plane'"):
        profile_of(still(whole, vehicle="plane"))
    with pytest.raises(BadRecording, match="8 s with attitude"):
        profile_of(whole, longest_s=8.0)


def test_of_a_vehicle_the_calibration_alone_goes_into_the_simulator() -> None:
    told = {
        "COMPASS_OFS_X": 0.0, "COMPASS_OFS_Y": 0.0, "COMPASS_OFS_Z": 0.0, "COMPASS_DIA_X": 1.1,
        "COMPASS_MOT_Z": 2.0, "COMPASS_MOTCT": 2.0, "COMPASS_SCALE": 1.02, "COMPASS_OFS2_X": 7.0,
        "COMPASS_DEV_ID": 97539.0, "COMPASS_USE": 1.0, "SERIAL1_BAUD": 57.0,
    }  # fmt: skip
    taken = ArduPilotSitl.calibration_in(told)
    assert taken.keys() == {name for name in told if name.startswith("COMPASS_")} - {
        "COMPASS_OFS2_X", "COMPASS_DEV_ID", "COMPASS_USE",
    }  # fmt: skip
    assert 0.0 < taken["COMPASS_OFS_X"] < 0.01, "all zero the simulator takes for not calibrated"


def test_a_model_that_pivots_is_chosen_for_a_motion_that_does(tmp_path: Path) -> None:
    sitl = ArduPilotSitl(tmp_path / "x")
    models = {("rover", False): "rover", ("rover", True): "rover-skid", ("copter", True): "quad"}
    for (kind, pivots), model in models.items():
        assert sitl.model_for(Flight(kind, pivots, None, 0.0)) == model
    mine = tmp_path / "mine.parm"
    mine.write_text("COMPASS_USE 1\nSIM_MAG_RND 3\n")
    values = ArduPilotSitl(tmp_path / "x", "", {"SIM_MAG_RND": 2.0}, [mine]).parameters_for(
        "rover-skid", {"SIM_MAG1_OFS_X": 9.0}
    )
    assert (values["COMPASS_USE"], values["SIM_MAG_RND"], values["SIM_MAG1_OFS_X"]) == (1.0, 3.0, 9.0)
    assert values["SERVO1_FUNCTION"] == 73.0 and values["ARMING_CHECK"] == 0.0


def test_px4_is_started_as_a_copter_whose_instance_and_files_are_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "bin" / "px4"
    program.parent.mkdir()
    help_or_note = "[ $1 = --help ] && echo '[-s <startup_file>]' || echo $PX4_HOME_LAT $* > told"
    program.write_text(f"#!/bin/sh\n{help_or_note}\n")
    program.chmod(0o755)
    with pytest.raises(UsageError, match="are not in the build"):
        simulator_of(program, "", (), None)
    startup = tmp_path / "etc" / "init.d-posix" / "rcS"
    startup.parent.mkdir(parents=True)
    startup.touch()
    sitl = simulator_of(program, "", (), 3.0)
    assert sitl.speed == 3.0 and sitl.live({"SIM_MAG_OFFSET_X": 0.05}) == {
        "MBE_LEARN_GAIN": 0.1, "SENS_MAG_AUTOCAL": 0, "SIM_MAG_OFFSET_X": 0.05,
    }  # fmt: skip
    monkeypatch.setattr(px4, "_LOCK", str(tmp_path / "lock-{}"))
    (tmp_path / "lock-0").touch()
    held = (
        "import fcntl, sys; f = open(sys.argv[1], 'r+b'); fcntl.lockf(f, fcntl.LOCK_EX); print(1, flush=True)"
    )
    words = [sys.executable, "-c", f"{held}; input()", str(tmp_path / "lock-0")]
    with subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE) as other:
        assert other.stdout is not None and other.stdout.readline()
        port = sitl.listen()
        other.communicate(b"\n")
    try:
        assert int(port.name.rpartition(":")[2]) > 14540, "instance 0 runs already"
        with (
            ExitStack() as taken,
            pytest.raises(UsageError, match="14540 to 14549, to which PX4 sends, are all"),
        ):
            while True:
                taken.enter_context(closing(sitl.listen()))
        with pytest.raises(UsageError, match="as a copter"):
            sitl.start(tmp_path, Flight("rover", False, None, 0.0), {}, port)
        running = sitl.start(tmp_path, Flight("copter", False, (47.4, 8.5, 500.0), 0.0), {}, port)
        while not running.has_ended:
            time.sleep(0.01)
    finally:
        port.close()
    told = (tmp_path / "told").read_text().strip()
    assert told.startswith("47.4") and f"-w {tmp_path}" in told and told.endswith(str(tmp_path / "etc"))
