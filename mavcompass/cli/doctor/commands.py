"""`mavcompass doctor`: what on this computer stands in the way, and its remedy."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from mavcompass.cli.options import Output, common_options
from mavcompass.cli.terminal.colour import styled

if TYPE_CHECKING:
    from mavcompass.cli.doctor.computer import Verdict

NOT_FIT = 5
_WORDS = {
    "pass": "Ready.",
    "warn": "Usable, as far as said above.",
    "fail": "First mend what is marked FAIL.",
}


@click.command()
@common_options
def command(output: Output) -> int:
    """Say what on this computer stands in the way of working with a vehicle, and how to mend it.

    It looks at Python, optional parts, serial ports and the right to open them, who listens on UDP port
    14550, the clock, the undo folder and the disk. It changes nothing. Exit code: 0, or 5 where something
    has to be mended first.

    \b
    Example: mavcompass doctor
    """
    from mavcompass.cli.doctor.computer import examine
    from mavcompass.cli.terminal.colour import mark

    findings = []
    for finding in examine():
        findings.append(finding)
        output.say(f"{mark(finding.verdict)}  {finding.text}")
        if finding.remedy:
            output.say(f"      {finding.remedy}")
    verdicts = {finding.verdict for finding in findings}
    worst: Verdict = "fail" if "fail" in verdicts else "warn" if "warn" in verdicts else "pass"
    output.say(styled(_WORDS[worst], bold=True))
    rows = [{"name": f.name, "verdict": f.verdict, "text": f.text, "remedy": f.remedy} for f in findings]
    output.write_json({"schema": "mavcompass.doctor/1", "verdict": worst, "findings": rows})
    return NOT_FIT if worst == "fail" else 0
