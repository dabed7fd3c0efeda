"""One program at a time works on a vehicle."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from serving import serving

from mavcompass.cli.main import main
from mavcompass.errors import Refused
from mavcompass.procedure.nameplate import Nameplate
from mavcompass.simulation.vehicle import SimulatedAutopilot
from mavcompass.vehicle.lock import VehicleLock

MINE = Nameplate("ardupilot", 1, os.urandom(8).hex(), compasses=(97_539,))
MUTE = Nameplate("ardupilot", 1)
HOLDER = """
import sys, time
from mavcompass.procedure.nameplate import Nameplate
from mavcompass.vehicle.lock import VehicleLock
lock = VehicleLock("tcp:here")
lock.hold(Nameplate("ardupilot", 1, sys.argv[1]))
print("held", flush=True)
time.sleep(300)
"""


def test_the_second_is_refused_and_told_who_holds_it_until_he_lets_go() -> None:
    with VehicleLock("tcp:here") as first, VehicleLock("udp:there") as second:
        first.hold(MINE)
        first.hold(MINE)
        with pytest.raises(Refused, match=rf"{MINE.uid}.*process \d+, .*pytest|python") as refused:
            second.hold(MINE)
        assert "then run again" in refused.value.remedy
        first.release()
        second.hold(MINE)
    with VehicleLock("tcp:here") as third:
        third.hold(MINE)


def test_another_vehicle_is_not_held_nor_one_without_a_unique_id_at_another_address() -> None:
    with VehicleLock("tcp:here") as first, VehicleLock("tcp:there") as second:
        first.hold(MINE)
        second.hold(Nameplate("ardupilot", 2, MINE.uid))
        second.hold(Nameplate("ardupilot", 1, os.urandom(8).hex()))
        first.hold(MUTE)
        second.hold(MUTE)
        with VehicleLock("tcp:here") as third, pytest.raises(Refused):
            third.hold(MUTE)


def test_a_dead_process_holds_nothing(start_process: Callable[..., subprocess.Popen[str]]) -> None:
    holder = start_process(sys.executable, "-c", HOLDER, MINE.uid)
    assert holder.stdout is not None and holder.stdout.readline() == "held\n"
    with VehicleLock("tcp:here") as lock:
        with pytest.raises(Refused, match=f"process {holder.pid}, "):
            lock.hold(MINE)
        holder.send_signal(signal.SIGKILL)
        holder.wait()
        lock.hold(MINE)


def test_nobody_writes_while_another_process_calibrates(
    start_process: Callable[..., subprocess.Popen[str]],
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("MAVCOMPASS_UNDO_DIR", str(tmp_path))
    file = tmp_path / "wanted.param"
    file.write_text("COMPASS_OFS_X,77\n")
    vehicle = SimulatedAutopilot("rover", seed=3)
    with serving(vehicle, speed=6.0) as (_, port):
        source = f"tcp:127.0.0.1:{port}"
        words = ["-m", "mavcompass", "calibrate", source, "--dry-run"]
        calibrating = start_process(sys.executable, *words)
        assert calibrating.stderr is not None
        for line in calibrating.stderr:
            if "urn" in line:  # it turns: it holds the vehicle
                break
        assert main(["params", "write", source, str(file), "--yes"]) == 7
        told = capsys.readouterr().err
        assert f"process {calibrating.pid}, " in told and "calibrate" in told
        assert main(["params", "show", source]) == 0
        assert calibrating.wait(60.0) == 0
        assert main(["params", "write", source, str(file), "--yes"]) == 0
    assert vehicle.firmware.store["COMPASS_OFS_X"] == 77.0
