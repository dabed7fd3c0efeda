"""What leaves a simulated vehicle: a message, its sender, its time, and the port it goes to."""

from __future__ import annotations

from dataclasses import dataclass

from mavcompass.messages import Message


@dataclass(frozen=True, slots=True)
class Outgoing:
    """Wrap a message that the simulated vehicle sends.

    Attributes:
        time_s: virtual time at which it left.
        system, component: the sender; not always the vehicle, for it forwards other stations.
        port: the port it leaves by, None for all of them.
    """

    time_s: float
    system: int
    component: int
    message: Message
    port: int | None = None
