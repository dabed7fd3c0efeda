"""What a ground station receives while the service calibrates a simulated rover, as a page to be pictured.

The ground station is pymavlink alone: it starts the calibration by DO_START_MAG_CAL and listens. The page
shows each message under the name of the window in which QGroundControl or Mission Planner has it.
"""

from __future__ import annotations

import html
import math
import re
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from typing import Any

from pymavlink import mavutil

_COMPANION, _DO_START_MAG_CAL, _UDP_PORT, _PATIENCE_S = 191, 42424, 14_577, 90.0
_SEVERITIES = {3: "error", 4: "warning", 5: "notice"}
_PAGE = """<!doctype html><meta charset="utf-8"><style>
:root {{ color-scheme: light dark }}
body {{ margin: 0; padding: 16px 20px; background: light-dark(#f8fafc, #0f172a);
       color: light-dark(#0f172a, #e2e8f0); font: 14px/1.5 "DejaVu Sans", sans-serif }}
h2 {{ font-size: 14px; margin: 14px 0 4px }}
small {{ color: light-dark(#64748b, #94a3b8); font-weight: normal }}
table {{ border-collapse: collapse; width: 100% }}
td {{ padding: 2px 8px 2px 0; vertical-align: top }}
td:first-child {{ width: 190px }} td.n {{ text-align: right; width: 70px; padding-right: 16px }}
.error {{ color: light-dark(#b91c1c, #fca5a5) }} .warning {{ color: light-dark(#a16207, #fcd34d) }}
.bar {{ display: inline-block; width: 260px; height: 10px; background: light-dark(#e2e8f0, #334155) }}
.bar i {{ display: block; height: 10px; background: light-dark(#0f766e, #5eead4) }}
</style>
<h2>Messages
<small>STATUSTEXT: the message list of QGroundControl, the Messages tab of Mission Planner</small></h2>
<table>{texts}</table>
<h2>Onboard mag calibration
<small>MAG_CAL_PROGRESS, MAG_CAL_REPORT: Mission Planner, component 191 chosen</small></h2>
<table>{progress}</table>
<h2>Quick
<small>NAMED_VALUE_FLOAT: the Quick tab of Mission Planner, after the calibration</small></h2>
<table>{values}</table>
<h2>MAVLink Inspector
<small>system 1, component 191: Analyze Tools of QGroundControl, Ctrl-F in Mission Planner</small></h2>
<table>{inspected}</table>"""


def page(folder: Path, environment: dict[str, str]) -> str:
    """Calibrate a simulated rover by MAVLink alone and return the page of what was heard."""
    address = f"127.0.0.1:{_UDP_PORT}"
    program = [sys.executable, "-m", "mavcompass"]
    serve = ["serve", f"udpin:{address}", "--http", "127.0.0.1:0", "--storage", "companion"]
    vehicle = ["simulate", "--vehicle", "rover", "--listen", f"udpout:{address}", "--speed", "4", "--quiet"]
    running: list[subprocess.Popen[str]] = []
    try:
        for words in (serve, vehicle):
            out = subprocess.PIPE if words is serve else subprocess.DEVNULL
            running.append(
                subprocess.Popen([*program, *words], cwd=folder, env=environment, stdout=out, text=True)
            )
            if running[-1].stdout is not None:
                running[-1].stdout.readline()  # it is ready once it says so
        return _drawn(_heard(f"udpout:{address}"))
    finally:
        for process in running:
            process.terminate()
            process.wait()


def _heard(address: str) -> list[Any]:
    """Start a calibration that writes; return what component 191 said until its report and a while after."""
    link = mavutil.mavlink_connection(address, source_system=255, source_component=190)
    heard: list[Any] = []
    began, beat_s, asked_s, end_s = time.monotonic(), 0.0, math.inf, math.inf
    while (now_s := time.monotonic()) < min(began + _PATIENCE_S, end_s):
        if now_s >= beat_s:
            link.mav.heartbeat_send(
                mavutil.mavlink.MAV_TYPE_GCS, mavutil.mavlink.MAV_AUTOPILOT_INVALID, 0, 0, 4
            )
            beat_s = now_s + 0.5
        message = link.recv_match(blocking=True, timeout=0.2)
        if message is None or message.get_srcComponent() != _COMPANION:
            continue
        heard.append(message)
        if asked_s == math.inf and message.get_type() == "NAMED_VALUE_FLOAT":
            asked_s = now_s
            link.mav.command_long_send(1, _COMPANION, _DO_START_MAG_CAL, 0, 1, 0, 1, 0, 0, 0, 0)
        if message.get_type() == "MAG_CAL_REPORT" and end_s == math.inf:
            end_s = now_s + 5.0
    link.close()
    if end_s == math.inf:
        raise SystemExit("pictures: the ground station heard no MAG_CAL_REPORT.")
    return heard


def _drawn(heard: list[Any]) -> str:
    last = {message.get_type(): message for message in heard}
    counts = Counter(message.get_type() for message in heard)
    texts = [
        f'<tr class="{_SEVERITIES.get(m.severity, "")}"><td>component 191</td><td>{html.escape(m.text)}</td>'
        for m in heard
        if m.get_type() == "STATUSTEXT"
    ]
    progress = [m for m in heard if m.get_type() == "MAG_CAL_PROGRESS" and m.completion_pct in (30, 60)]
    steps = {m.completion_pct: m for m in progress}
    report = last["MAG_CAL_REPORT"]
    bars = [(f"compass {report.compass_id + 1}", percent, f"{percent} %") for percent in sorted(steps)]
    offsets = f"offsets {report.ofs_x:.0f} {report.ofs_y:.0f} {report.ofs_z:.0f}"
    bars.append((f"compass {report.compass_id + 1}", 100, f"{offsets}, fitness {report.fitness:.2f}, saved"))
    values = {m.name: m.value for m in heard if m.get_type() == "NAMED_VALUE_FLOAT"}
    return _PAGE.format(
        texts="".join(dict.fromkeys(texts)),
        progress="".join(
            f'<tr><td>{name}</td><td><span class="bar"><i style="width:{percent}%"></i></span> {words}</td>'
            for name, percent, words in bars
        ),
        values="".join(f"<tr><td>MAV_{name}</td><td>{value:.1f}</td></tr>" for name, value in values.items()),
        inspected="".join(
            f'<tr><td>{name}</td><td class="n">{counts[name]}</td><td>{_fields(message)}</td></tr>'
            for name, message in sorted(last.items())
            if name != "COMMAND_ACK"
        ),
    )


def _fields(message: Any) -> str:
    fields = [f"{name} {getattr(message, name)}" for name in message.get_fieldnames()]
    shown = re.sub(r"(\d\.\d{2})\d+", r"\1", ", ".join(fields))
    return html.escape(shown if len(shown) < 84 else f"{shown[:80]} ...")
