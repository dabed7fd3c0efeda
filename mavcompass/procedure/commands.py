"""Commands with their acknowledgement, and message rates that are put back as they were."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from mavcompass import messages as mav
from mavcompass.enums import MavCmd, MavResult
from mavcompass.errors import NoReply
from mavcompass.procedure.script import Context, Script, expect

# Where a third is lost each way half of the tries fail; twelve in a row are one case in 4000.
TRIES = 12
DISABLED_US = -1
# A vehicle that says nothing for so long is not asked any more.
_SILENCE_S = 4.0
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

    IN_PROGRESS is not an answer: the wait goes on. Raises NoReply.
    """
    for attempt in range(tries):
        context.command(number, *params, attempt=attempt)
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
        granted: dict[type[mav.Message], bool | None] = {}
        for kind, rate_hz in rates_hz.items():
            before = yield from self.interval_us(context, kind)
            if before is not None and 0 < before <= 1e6 / rate_hz * 1.02:
                granted[kind] = True
                continue
            # Kept before it is changed: an answer may be lost and the rate set all the same.
            self._before_us.setdefault(kind, DEFAULT_US if before is None else before)
            granted[kind] = yield from self._ask_one(context, kind, rate_hz)
            if granted[kind] is False:
                del self._before_us[kind]
            if not any(yes is not None for yes in granted.values()):
                break  # it does not know the command at all
        return {kind: yes is True for kind, yes in granted.items()}

    def _ask_one(self, context: Context, kind: type[mav.Message], rate_hz: float) -> Script[bool | None]:
        """Ask for one rate; None where no answer came, whatever that means."""
        result = MavResult.DENIED
        # ArduPilot denies more than 0.8 of its loop rate and keeps the old rate.
        for hz in (rate_hz, rate_hz / 2.0, rate_hz / 4.0):
            try:
                result = yield from self._set(context, kind, round(1e6 / hz))
            except NoReply:
                return None
            if result not in (MavResult.DENIED, MavResult.FAILED):
                break
        return result == MavResult.ACCEPTED

    def restore(self, context: Context) -> Script[None]:
        """Put back every rate that was changed; a vehicle that no longer says anything is left."""
        began_s = context.now
        while self._before_us and context.now - max(began_s, context.heard_s) < _SILENCE_S:
            kind, before_us = next(reversed(self._before_us.items()))
            if (yield from self._put_back(context, kind, before_us)):
                del self._before_us[kind]
        if self._before_us:
            context.show("end", "The vehicle no longer answers: its message rates were not put back.")

    def _put_back(self, context: Context, kind: type[mav.Message], before_us: int) -> Script[bool]:
        """Put one rate back; False where no answer came."""
        try:
            # An answer may be a late one to the message before: ask what came of it.
            for _ in range(3):
                yield from self._set(context, kind, before_us, tries=2)
                is_now = None if before_us == DEFAULT_US else (yield from self.interval_us(context, kind))
                if is_now in (None, before_us):
                    break
        except NoReply:
            return False
        return True

    def interval_us(self, context: Context, kind: type[mav.Message]) -> Script[int | None]:
        """Ask how often a message is sent, in microseconds; None where no answer comes."""
        number = mav.message_id(kind)
        for _ in range(6):
            context.command(MavCmd.GET_MESSAGE_INTERVAL, number)
            answer = yield from expect(context, mav.MessageInterval, lambda m: m.message_id == number, 0.5)
            if answer is not None:
                return answer.interval_us
        return None

    def _set(
        self, context: Context, kind: type[mav.Message], interval_us: int, tries: int = TRIES
    ) -> Script[MavResult]:
        number, numbers = MavCmd.SET_MESSAGE_INTERVAL, (mav.message_id(kind), interval_us)
        what = f"the rate of {kind.wire_name()}"
        return (yield from command(context, number, *numbers, what=what, tries=tries))
