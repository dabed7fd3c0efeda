"""Nothing is sent anywhere: no telemetry, no look for updates (SECURITY.md)."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from mavcompass.gap.trial.cases import Recipe, make_track
from mavcompass.logs import write_track_csv

_WATCHED = """
import json, sys
SPEAKS = {"socket.connect", "socket.sendto", "socket.sendmsg", "socket.getaddrinfo", "socket.gethostbyname"}
spoken = []
def hook(event, args):
    if event in SPEAKS:
        where = args[0] if isinstance(args[0], str) else args[1]
        if not isinstance(where, bytes):  # the lock between programs is a local socket
            spoken.append(repr(where))
sys.addaudithook(hook)
from mavcompass.cli.main import main
codes = [main(words) for words in json.loads(sys.argv[1])]
print(json.dumps([codes, spoken]))
"""


def test_no_command_speaks_to_a_network_that_no_address_names(tmp_path: Path) -> None:
    flight = str(tmp_path / "flight.csv")
    write_track_csv(make_track(Recipe("yaw-steps", duration_s=30.0, seed=4)), Path(flight))
    commands = [
        ["calibrate", flight, "--json", f"{tmp_path}/result.json", "--report", f"{tmp_path}/report.html"],
        ["heading", flight, "--json-lines"],
        ["params", "show", "sim:rover"],
        ["params", "backup", "sim:rover", f"{tmp_path}/backup.param"],
        ["gap", "catalogue"],
        ["doctor"],
        ["params", "show", "tcp:127.0.0.1:1"],
    ]
    environment = {**os.environ, "XDG_STATE_HOME": str(tmp_path)}
    words = [sys.executable, "-c", _WATCHED, json.dumps(commands)]
    run = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=300, check=True)
    codes, spoken = json.loads(run.stdout.splitlines()[-1])
    assert len(codes) == len(commands) and 1 not in codes, run.stderr
    assert spoken and all("127.0.0.1" in where for where in spoken), spoken
