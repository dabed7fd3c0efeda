"""Commands with their acknowledgement, and message rates that are put back as they were."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from mavcompass import messages as mav
from mavcompass.enums import MavCmd, MavResult
from mavcompass.errors import NoReply
from mavcompass.procedure.script import Context, Script, expect

# Ids of the messages whose rates are asked for.
MESSAGE_IDS = {
    mav.SysStatus: 1,
    mav.SystemTime: 2,
    mav.GpsRawInt: 24,
    mav.ScaledImu: 26,
    mav.RawImu: 27,
    mav.Attitude: 30,
    mav.LocalPositionNed: 32,
    mav.GlobalPositionInt: 33,
    mav.RcChannels: 65,
    mav.HighresImu: 105,
    mav.ScaledImu2: 116,
    mav.ScaledImu3: 129,
    mav.Simstate: 164,
    mav.EkfStatusReport: 193,
    mav.ExtendedSysState: 245,
}
# Where a third is lost each way half of the tries fail; twelve in a row are one case in 4000.
TRIES = 12
DISABLED_US = -1
DEFAULT_US = 0


def command(
    context: Context,
    number: MavCmd,
    *params: float,
    what: str = "",
    timeout_s: float = 0.8,
    tries: int = TRIES,
) -> Script[MavResult]:
    """Send COMMAND_LONG until acknowledged and return the answer, whatever it is.

    IN_PROGRESS is not an answer: the wait goes on. A repeated command counts `confirmation` up, as
    the protocol asks. Raises NoReply.
    """
    padded = [*(float(p) for p in params), *([0.0] * 7)][:7]
    for attempt in range(tries):
        context.send(mav.CommandLong(context.system, context.component, int(number), attempt, *padded))
        patience = timeout_s * min(1.0 + 0.5 * attempt, 2.0)
        while True:
            ack = yield from expect(context, mav.CommandAck, lambda a: a.command == int(number), patience)
            if ack is None or ack.result != MavResult.IN_PROGRESS:
                break
            patience = 10.0
        if ack is not None:
            return MavResult(ack.result) if ack.result in list(MavResult) else MavResult.FAILED
    raise NoReply(
        f"The vehicle did not answer {what or number.name} ({tries} tries).",
        "Check the link; if it is slow or lossy, bring the radios closer and run again.",
    )


@dataclass(slots=True)
class MessageRates:
    """Ask for message rates, remember what they were, and put them back."""

    _before_us: dict[type[mav.Message], int] = field(default_factory=dict)

    def ask(
        self, context: Context, rates_hz: Mapping[type[mav.Message], float]
    ) -> Script[dict[type[mav.Message], bool]]:
        """Ask for each message at its rate, or at a lower one where the vehicle denies it.

        Returns which were granted. Vehicles that do not know SET_MESSAGE_INTERVAL grant none; what
        they stream by themselves may still be enough.
        """
        granted: dict[type[mav.Message], bool] = {}
        for kind, rate_hz in rates_hz.items():
            before = yield from self._interval_us(context, kind)
            if before is not None and 0 < before <= 1e6 / rate_hz * 1.02:
                granted[kind] = True
                continue
            result = MavResult.DENIED
            # ArduPilot denies more than 0.8 of its loop rate and keeps the old rate.
            for hz in (rate_hz, rate_hz / 2.0, rate_hz / 4.0):
                result = yield from self._set(context, kind, round(1e6 / hz))
                if result not in (MavResult.DENIED, MavResult.FAILED):
                    break
            granted[kind] = result == MavResult.ACCEPTED
            if granted[kind]:
                self._before_us.setdefault(kind, DEFAULT_US if before is None else before)
        return granted

    def restore(self, context: Context) -> Script[None]:
        """Put back every rate that was changed; a vehicle that no longer answers is left."""
        while self._before_us:
            kind, before_us = self._before_us.popitem()
            try:
                yield from self._set(context, kind, before_us, tries=8)
            except NoReply:
                return

    def _interval_us(self, context: Context, kind: type[mav.Message]) -> Script[int | None]:
        number = MESSAGE_IDS[kind]
        for _ in range(3):
            context.send(
                mav.CommandLong(
                    context.system, context.component, MavCmd.GET_MESSAGE_INTERVAL, 0, float(number)
                )
            )
            answer = yield from expect(context, mav.MessageInterval, lambda m: m.message_id == number, 0.5)
            if answer is not None:
                return answer.interval_us
        return None

    def _set(
        self, context: Context, kind: type[mav.Message], interval_us: int, tries: int = TRIES
    ) -> Script[MavResult]:
        return (
            yield from command(
                context,
                MavCmd.SET_MESSAGE_INTERVAL,
                float(MESSAGE_IDS[kind]),
                float(interval_us),
                what=f"the rate of {kind.wire_name()}",
                tries=tries,
            )
        )
