"""Exports to other simulators: our own, PX4's (an offset, no more), Gazebo's magnetometer.

PX4's sensor_mag_sim (SIH, jMAVSim) reports field + SIM_MAG_OFFSET in gauss, with a noise of its own that no
parameter changes. Gazebo's axes are x forward, y left, z up, its unit is the tesla; `mean` is the constant:
`bias_mean` is drawn with either sign. Gains, oblique axes and what goes with motors or places need a plugin
of the world's own.
"""

from __future__ import annotations

import json
import math
from xml.sax.saxutils import escape

import numpy as np

from mavcompass.gap.export.vehicle import Exported, Found, commented
from mavcompass.simulation.effects import spell
from mavcompass.simulation.effects.registry import PRESET_SCHEMA

_PX4 = "PX4's simulated magnetometer"
_GAZEBO = "Gazebo's magnetometer"
_TESLA = 1e-7
_LEFT_UP = np.array([1.0, -1.0, -1.0])
_WANDERS_S = 3600.0


def preset(found: Found) -> Exported:
    """Write a preset: `mavcompass simulate --effect @FILE`."""
    document = {
        "schema": PRESET_SCHEMA,
        "source": found.source,
        "effects": [spell(s) for s in found.settings],
    }
    use = "mavcompass calibrate sim:rover --dry-run --effect @FILE"
    return Exported(json.dumps(document, indent=2) + "\n", use)


def px4_sitl(found: Found) -> Exported:
    """Write a parameter file in the form of PX4's ground stations: system, component, name, value, type."""
    offset, lacking, left_out = found.offset_alone(_PX4)
    parameters = {f"SIM_MAG_OFFSET_{axis}": float(offset[i]) / 1000.0 for i, axis in enumerate("XYZ")}
    lost, gone = found.lost(_PX4, lambda setting: None)
    lacking, left_out = lacking + lost, left_out + gone
    lines = commented("#", found.headed(_PX4))
    lines += commented("# not in the simulator:", lacking)
    lines += [f"1\t1\t{name}\t{value:.9g}\t9" for name, value in parameters.items()]
    text = "\n".join(lines) + "\n"
    return Exported(text, "load FILE in QGroundControl", parameters, tuple(lacking), tuple(left_out))


def gazebo(found: Found) -> Exported:
    """Write the <sensor> of a model; noise and steps are those that were found beside the simulator's."""
    offset, lacking, left_out = found.offset_alone(_GAZEBO)
    values = {s.effect.id: s.values for s in found.settings}
    held = {"noise_excess", "quantisation", "bias_random_walk"}
    lost, gone = found.lost(_GAZEBO, lambda setting: setting.effect.id in held)
    lacking, left_out = lacking + lost, left_out + gone
    scatter = _TESLA * values.get("noise_excess", {}).get("sigma_mgauss", 0.0)
    step = _TESLA * values.get("quantisation", {}).get("step_mgauss", 0.0)
    walk = values.get("bias_random_walk", {}).get("sigma_mgauss_per_sqrt_s", 0.0)
    kind = "gaussian_quantized" if step else "gaussian"
    lines = ['<?xml version="1.0"?>']
    head, *known = (escape(sentence).replace("--", "- -") for sentence in found.headed(_GAZEBO))
    lines += [f"<!-- {head}: tesla, x forward, y left, z up."]
    lines += [f"     In the vehicle's axes, x forward, y right, z down: {sentence}" for sentence in known]
    lines += [f"     Not in the simulator: {escape(sentence)}" for sentence in lacking]
    lines += ["-->", '<sensor name="magnetometer_sensor" type="magnetometer">', "  <always_on>1</always_on>"]
    lines += ["  <update_rate>100</update_rate>", "  <magnetometer>"]
    for axis, mean in zip("xyz", (_TESLA * _LEFT_UP * offset).tolist(), strict=True):
        lines += [f'    <{axis}><noise type="{kind}">', f"      <mean>{mean:.6g}</mean>"]
        lines += [f"      <stddev>{scatter:.6g}</stddev>"]
        if walk:
            # A walk that is held back only after an hour.
            lines += [
                f"      <dynamic_bias_stddev>{_TESLA * walk * math.sqrt(_WANDERS_S / 2.0):.6g}"
                "</dynamic_bias_stddev>",
                f"      <dynamic_bias_correlation_time>{_WANDERS_S:g}</dynamic_bias_correlation_time>",
            ]
        if step:
            lines += [f"      <precision>{step:.6g}</precision>"]
        lines += [f"    </noise></{axis}>"]
    lines += ["  </magnetometer>", "</sensor>"]
    use = "put FILE into the model's <link>, in the place of its magnetometer"
    return Exported("\n".join(lines) + "\n", use, {}, tuple(lacking), tuple(left_out))
