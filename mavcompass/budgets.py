"""What reading a recording may cost, whatever it says: stated here, held by tests and a campaign.

Memory and time follow a file's bytes; nothing in it, no span, count or length, is believed before the bytes
bear it out. `scripts/campaigns/hostile_recordings.py` runs every command over some hundreds of hostile files.
"""

from __future__ import annotations

# A command that reads a hostile recording, of three gigabytes or of none: processor time, and memory in all.
HOSTILE_S = 10.0
HOSTILE_MB = 300.0
