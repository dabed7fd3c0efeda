"""PX4's simulated magnetometer (sensor_mag_sim: SIH, jMAVSim), by its parameters: an offset, no more.

It reports field + SIM_MAG_OFFSET in gauss, with a noise of its own that no parameter changes.
"""

from __future__ import annotations

from mavcompass.gap.export.exported import Exported, Found, commented

SIMULATOR = "PX4's simulated magnetometer"


def px4_sitl(found: Found) -> Exported:
    """Write a parameter file in the form of PX4's ground stations: system, component, name, value, type."""
    offset, lacking, left_out = found.offset_alone(SIMULATOR)
    parameters = {f"SIM_MAG_OFFSET_{axis}": float(offset[i]) / 1000.0 for i, axis in enumerate("XYZ")}
    lost = [s for s in found.settings if not s.effect.affine]
    lacking += [found.without(s, SIMULATOR) for s in lost]
    left_out += [s.effect.id for s in lost]
    lines = commented("#", found.headed(SIMULATOR))
    lines += commented("# not in the simulator:", lacking)
    lines += [f"1\t1\t{name}\t{value:.9g}\t9" for name, value in parameters.items()]
    text = "\n".join(lines) + "\n"
    return Exported(text, "load FILE in QGroundControl", parameters, tuple(lacking), tuple(left_out))
