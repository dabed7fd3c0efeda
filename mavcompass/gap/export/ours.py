"""Our own simulator: every effect, exactly."""

from __future__ import annotations

import json

from mavcompass.gap.export.exported import Exported, Found
from mavcompass.simulation.effects import spell
from mavcompass.simulation.effects.registry import PRESET_SCHEMA


def preset(found: Found) -> Exported:
    """Write a preset: `mavcompass simulate --effect @FILE`."""
    document = {
        "schema": PRESET_SCHEMA,
        "source": found.source,
        "effects": [spell(s) for s in found.settings],
    }
    use = "mavcompass calibrate sim:rover --dry-run --effect @FILE"
    return Exported(json.dumps(document, indent=2) + "\n", use)
