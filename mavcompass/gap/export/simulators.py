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
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass
from string import Template
from xml.sax.saxutils import escape

import numpy as np

from mavcompass.frames import FloatArray
from mavcompass.gap.export.vehicle import Exported, Found, affine_map, commented
from mavcompass.gap.tables import usual
from mavcompass.simulation.effects import Setting, spell
from mavcompass.simulation.effects.effect import NEVER_S
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
_FIRST_MOTOR = 33


@dataclass(frozen=True, slots=True, eq=False)
class InArduPilot:
    """Hold what the simulator makes of a vehicle: raw = P field + b by its parameters, and what it lacks."""

    stretch: FloatArray
    offset_mgauss: FloatArray
    parameters: dict[str, float]
    lacking: tuple[str, ...]
    left_out: tuple[str, ...]


def in_ardupilot(found: Found, written: Collection[str] = ()) -> InArduPilot:
    """Compose all affine effects for the simulator, beside whose parameters others may be `written`."""
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
    return InArduPilot(stretch, offset, parameters, tuple(lacking), tuple(gone))


def ardupilot_sitl(found: Found) -> Exported:
    """Write a parameter file that ArduPilot's simulator and ground stations load."""
    held = in_ardupilot(found)
    lines = commented("#", found.headed(SIMULATOR)) + commented("# not in the simulator:", held.lacking)
    lines += [f"{name},{value:.6g}" for name, value in held.parameters.items()]
    use = "sim_vehicle.py --add-param-file=FILE"
    return Exported("\n".join(lines) + "\n", use, held.parameters, held.lacking, held.left_out)


_FRAME = Template("""\
$head
local PARAMETERS = {
$parameters
}
-- raw = MATRIX field + OFFSET, in mG, body axes
local MATRIX = { $matrix }
local OFFSET = { $offset }

for name, value in pairs(PARAMETERS) do param:set(name, value) end

local function since_boot_s() return millis():tofloat() / 1000.0 end

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


def _listed(values: Mapping[str, float], names: str) -> str:
    return ", ".join(f"{values[name]:.6g}" for name in names)


def _during(values: Mapping[str, float], on: str, off: str) -> str:
    said = []
    if values[on] > -NEVER_S:
        said.append(f"since_boot_s() >= {values[on]:.3f}")
    if values[off] < NEVER_S:
        said.append(f"since_boot_s() < {values[off]:.3f}")
    return " and ".join(said) or "true"


def _step(v: Mapping[str, float]) -> str:
    return f"if {_during(v, 'on_s', 'off_s')} then add(b, {_listed(v, 'xyz')}) end"


def _temperature(v: Mapping[str, float]) -> str:
    above = f"local above = baro:get_temperature() - {v['reference_degc']:.3f}"
    return f"{above}\n    add(b, {', '.join(f'above * {v[a]:.6g}' for a in 'xyz')})"


def _motor(number: int) -> str:
    return f"((SRV_Channels:get_output_pwm({_FIRST_MOTOR + number}) or 1000) - 1000) / 1000"


def _per_motor(v: Mapping[str, float]) -> str:
    lines = []
    for m in range(8):
        field = [v.get(f"motor{m + 1}_{a}", 0.0) for a in "xyz"]
        if any(field):
            terms = ", ".join(f"m * {one:.6g}" for one in field)
            lines.append(f"do local m = {_motor(m)}; add(b, {terms}) end")
    return "\n    ".join(lines)


def _relay(v: Mapping[str, float]) -> str | None:
    source = round(v["source"])
    if source == 0:
        return None
    load = "(battery:current_amps(0) or 0)" if source == 1 else _motor(source - 2)
    return f"if {load} > {v['threshold']:.6g} then add(b, {_listed(v, 'xyz')}) end"


def _dipole(v: Mapping[str, float]) -> str:
    return f"""local p = ahrs:get_relative_position_NED_origin()
    if p and {_during(v, "on_s", "off_s")} then
      local x, y, z = p:x() - {v["north_m"]:.4f}, p:y() - {v["east_m"]:.4f}, p:z() - {v["down_m"]:.4f}
      local r = math.sqrt(math.max(x * x + y * y + z * z, 0.0025))
      x, y, z = x / r, y / r, z / r
      local mn, me, md = {v["moment_north"]:.6g}, {v["moment_east"]:.6g}, {v["moment_down"]:.6g}
      local along, cube = 3 * (x * mn + y * me + z * md), r * r * r
      add_world(b, (x * along - mn) / cube, (y * along - me) / cube, (z * along - md) / cube)
    end"""


def _gradient(v: Mapping[str, float]) -> str:
    nn, ee, ne, nd, ed = (v[name] for name in ("nn", "ee", "ne", "nd", "ed"))
    rows = ((nn, ne, nd), (ne, ee, ed), (nd, ed, -nn - ee))
    terms = [f"p:x() * {a:.6g} + p:y() * {b:.6g} + p:z() * {c:.6g}" for a, b, c in rows]
    return (
        "local p = ahrs:get_relative_position_NED_origin()\n    if p then\n      add_world(b, "
        + ",\n        ".join(terms)
        + ")\n    end"
    )


_WRITERS: Mapping[str, Callable[[Mapping[str, float]], str | None]] = {
    "hard_iron_step": _step,
    "temperature_bias": _temperature,
    "per_motor": _per_motor,
    "relay_field": _relay,
    "spatial_dipole": _dipole,
    "field_gradient": _gradient,
}


def _written(setting: Setting) -> str | None:
    writer = _WRITERS.get(setting.effect.id)
    return None if writer is None else writer(setting.values)


def ardupilot_lua(found: Found) -> Exported:
    """Write a Lua script for the simulator's scripts folder."""
    texts = {s.effect.id: text for s in found.settings if (text := _written(s)) is not None}
    effects = [f"  function(b) -- {effect}\n    {text}\n  end," for effect, text in texts.items()]
    held = in_ardupilot(found, texts)
    head = [*found.headed(SIMULATOR), "Put it into scripts/, with SCR_ENABLE 1 in the parameters."]
    head += [f"Not in the simulator: {s}" for s in held.lacking]
    text = _FRAME.substitute(
        head="\n".join(commented("--", head)),
        parameters="\n".join(f"  {n} = {v:.6g}," for n, v in held.parameters.items() if "_OFS_" not in n),
        matrix=", ".join("{ " + ", ".join(f"{x:.6g}" for x in row) + " }" for row in held.stretch.tolist()),
        offset=", ".join(f"{x:.6g}" for x in held.offset_mgauss.tolist()),
        effects="\n".join(effects),
    )
    use = "cp FILE scripts/ beside the simulator, and start it with SCR_ENABLE 1"
    return Exported(text, use, held.parameters, held.lacking, held.left_out)
