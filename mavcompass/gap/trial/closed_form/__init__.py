"""Another simulator: recordings in closed form, by code that shares nothing with this one but the contract.

It imports numpy alone. What it yields are the columns of a Track CSV by their contract names, and effects by
the catalogue's ids and units. Attitude, place, field and loads are formulas of the time, and so are their
derivatives: nothing is integrated, filtered or interpolated, and a late reading is the formula at an earlier
time.

    raw(t) = S (f(t)) + b + c I(t) + k (T(t) - T0),   f = (Rz(psi) Ry(theta) Rx(phi))^T B(p(t))

A compass head that is carried about: yaw, pitch and roll are sums of sines beside a steady turn, its place a
Lissajous figure; the autopilot's attitude is the true one with slow sines of its own.
"""

from mavcompass.gap.trial.closed_form.simulator import UTC_S, Made, Simulated, make

__all__ = ["UTC_S", "Made", "Simulated", "make"]
