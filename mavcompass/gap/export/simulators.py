"""A file per simulator: our own, PX4's (an offset, no more), Gazebo's magnetometer, ArduPilot's compass 1.

PX4's sensor_mag_sim (SIH, jMAVSim) reports field + SIM_MAG_OFFSET in gauss, with a noise of its own that no
parameter changes. Gazebo's axes are x forward, y left, z up, its unit is the tesla; `mean` is the constant:
`bias_mean` is drawn with either sign. Gains, oblique axes and what goes with motors or places need a plugin
of the world's own.

ArduPilot's makes raw = E^-1 field - OFS with E symmetric (SIM_MAG1_DIA, SIM_MAG1_ODI). With raw = A field + b
and the polar form A = P R: E = P^-1, OFS = -b; the rotation R it does not have. Its script sets SIM_MAG1_OFS
fifty times a second to all that adds to the field of a compass: what switches, follows a temperature or the
motors, or belongs to a place.
"""

from __future__ import annotations

import json
import math
from collections.abc import Collection
from dataclasses import replace
from string import Template
from xml.sax.saxutils import escape

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.export.vehicle import Exported, Found, affine_map, commented
from mavcompass.gap.tables import usual
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
    offset, lacking, left_out = found.offset_alone(_PX4, held=())
    parameters = {f"SIM_MAG_OFFSET_{axis}": float(offset[i]) / 1000.0 for i, axis in enumerate("XYZ")}
    lines = commented("#", found.headed(_PX4))
    lines += commented("# not in the simulator:", lacking)
    lines += [f"1\t1\t{name}\t{value:.9g}\t9" for name, value in parameters.items()]
    text = "\n".join(lines) + "\n"
    return Exported(text, "load FILE in QGroundControl", parameters, tuple(lacking), tuple(left_out))


def gazebo(found: Found) -> Exported:
    """Write the <sensor> of a model; noise and steps are those that were found beside the simulator's."""
    held = ("noise_excess", "quantisation", "bias_random_walk")
    offset, lacking, left_out = found.offset_alone(_GAZEBO, held)
    values = {s.effect.id: s.values for s in found.settings}
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


SIMULATOR = "ArduPilot's simulator"
_AXES = "XYZ"
# Outputs by function: motors 1 to 8 are 33 to 40.
_BEFORE_THE_FIRST_MOTOR = 32


def in_ardupilot(found: Found, written: Collection[str] = ()) -> tuple[Exported, FloatArray, FloatArray]:
    """Compose all affine effects for the simulator, beside whose parameters others may be `written`.

    Returns the export, without a text yet, and P (3, 3) and b (3,): its parameters make raw = P field + b.
    """
    affine = [s for s in found.settings if s.effect.affine]
    matrix, offset = affine_map(affine)
    u, sizes, vt = np.linalg.svd(matrix)
    turn_rad = math.acos(float(np.clip((np.trace(u @ vt) - 1.0) / 2.0, -1.0, 1.0)))
    stretch, parameters = u @ np.diag(sizes) @ u.T, dict[str, float]()
    if affine:
        # Elements of the matrix come all together: the firmware ignores one of which only some are set.
        cure, places = np.linalg.inv(stretch), ((0, 1), (0, 2), (1, 2))
        parameters = {f"SIM_MAG1_OFS_{axis}": float(-offset[i]) for i, axis in enumerate(_AXES)}
        parameters |= {f"SIM_MAG1_DIA_{axis}": float(cure[i, i]) for i, axis in enumerate(_AXES)}
        parameters |= {f"SIM_MAG1_ODI_{a}": float(cure[ij]) for a, ij in zip(_AXES, places, strict=True)}
    for setting in found.settings:
        parameters |= setting.effect.sitl(setting.values) if setting.effect.sitl is not None else {}
    lost, gone = found.lost(SIMULATOR, lambda s: s.effect.sitl or s.effect.id in written)
    lacking = [*found.of_the_place(SIMULATOR), *lost]
    if turn_rad > usual.export.worth_saying_rad:
        turned = f"A rotation of the compass by {math.degrees(turn_rad):.2f} degrees"
        lacking.insert(0, f"{turned}: the simulator turns its compass only in steps (SIM_MAG1_ORIENT).")
        gone.insert(0, "misalignment")
    return Exported("", "", parameters, tuple(lacking), tuple(gone)), stretch, offset


def ardupilot_sitl(found: Found) -> Exported:
    """Write a parameter file that ArduPilot's simulator and ground stations load."""
    held, _, _ = in_ardupilot(found)
    lines = commented("#", found.headed(SIMULATOR)) + commented("# not in the simulator:", held.lacking)
    lines += [f"{name},{value:.6g}" for name, value in held.parameters.items()]
    return replace(held, text="\n".join(lines) + "\n", use="sim_vehicle.py --add-param-file=FILE")


_FRAME = Template("""\
$head
local PARAMETERS = {
$parameters
}
-- raw = MATRIX field + OFFSET, in mG, body axes
local MATRIX = { $matrix }
local OFFSET = { $offset }

for name, value in pairs(PARAMETERS) do param:set(name, value) end

local function during(on_s, off_s)
  local since_boot_s = millis():tofloat() / 1000.0
  return since_boot_s >= on_s and since_boot_s < off_s
end

local function motor(number)
  return ((SRV_Channels:get_output_pwm($before_the_first_motor + number) or 1000) - 1000) / 1000
end

local function add(b, x, y, z)
  b[1], b[2], b[3] = b[1] + x, b[2] + y, b[3] + z
end

-- A field of the world, north, east, down, seen by the compass.
local function add_world(b, north, east, down)
  local field = Vector3f()
  field:x(north) field:y(east) field:z(down)
  local f = ahrs:earth_to_body(field)
  for i = 1, 3 do
    b[i] = b[i] + MATRIX[i][1] * f:x() + MATRIX[i][2] * f:y() + MATRIX[i][3] * f:z()
  end
end

-- What a place adds: a function of how far north, east and down of a point the vehicle is.
local function add_place(b, north, east, down, field)
  local p = ahrs:get_relative_position_NED_origin()
  if p then add_world(b, field(p:x() - north, p:y() - east, p:z() - down)) end
end

local EFFECTS = {
$effects
}

function update()
  local b = { OFFSET[1], OFFSET[2], OFFSET[3] }
  for _, effect in ipairs(EFFECTS) do effect(b) end
  param:set('SIM_MAG1_OFS_X', -b[1])
  param:set('SIM_MAG1_OFS_Y', -b[2])
  param:set('SIM_MAG1_OFS_Z', -b[3])
  return update, 20
end

return update()
""")


def ardupilot_lua(found: Found) -> Exported:
    """Write a Lua script for the simulator's scripts folder."""
    said = ((s.effect, s.values) for s in found.settings)
    texts = {e.id: text for e, values in said if e.lua is not None and (text := e.lua(values))}
    effects = [f"  function(b) -- {effect}\n    {text}\n  end," for effect, text in texts.items()]
    held, stretch, offset = in_ardupilot(found, texts)
    head = [*found.headed(SIMULATOR), "Put it into scripts/, with SCR_ENABLE 1 in the parameters."]
    head += [f"Not in the simulator: {s}" for s in held.lacking]
    text = _FRAME.substitute(
        head="\n".join(commented("--", head)),
        parameters="\n".join(f"  {n} = {v:.6g}," for n, v in held.parameters.items() if "_OFS_" not in n),
        matrix=", ".join("{ " + ", ".join(f"{x:.6g}" for x in row) + " }" for row in stretch.tolist()),
        offset=", ".join(f"{x:.6g}" for x in offset.tolist()),
        effects="\n".join(effects),
        before_the_first_motor=_BEFORE_THE_FIRST_MOTOR,
    )
    use = "cp FILE scripts/ beside the simulator, and start it with SCR_ENABLE 1"
    return replace(held, text=text, use=use)
