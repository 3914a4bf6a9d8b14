"""What a car answers to single questions, with patience for a controller that is busy."""

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from enum import StrEnum
from functools import partial
from typing import Final

import numpy as np

from clutch_model.units import for_people
from clutchdiag_io.people import digits
from diag_service.diagnosis.columns import Signal
from diag_service.errors import StoppedError
from diag_service.mapping.asked_signals import NEGATIVE, DatumId, data_in, sizes_of
from diag_service.mapping.profile import Profile, to_si
from diag_service.mapping.signal_words import listed, signal_words
from workshop.tester.adapters import Line
from workshop.tester.addresses import CanAddress, id_text
from workshop.tester.answers import BUSY, PENDING, STOPPED, refusal_text
from workshop.tester.can_line import CanLine, GroupQuestion
from workshop.tester.signal_asking import MOST_SILENT, DataRequest, address_of

BUSY_PAUSE_S: Final = 0.5
Show = Callable[[str], object]


class AskOutcome(StrEnum):
    """What became of a question."""

    TOLD = "told"
    EMPTY = "no value now"
    REFUSED = "refused"
    UNREADABLE = "unlike the profile"
    BUSY = "busy"
    UNFINISHED = "asked for more time, and never answered"
    SILENT = "no answer"


_LATER: Final = {BUSY: AskOutcome.BUSY, PENDING: AskOutcome.UNFINISHED}  # refusals that say "not yet"


@dataclass(frozen=True, slots=True, kw_only=True)
class CarReply:
    """What became of a question, and the values in SI."""

    question: DataRequest | GroupQuestion
    signals: tuple[Signal, ...]  # that it is about
    outcome: AskOutcome
    detail: str = ""
    values: Mapping[Signal, float] = field(default_factory=dict)

    @property
    def has_answer(self) -> bool:
        return self.outcome in {AskOutcome.TOLD, AskOutcome.EMPTY}

    def __str__(self) -> str:
        """Return the reply with what was asked for, for whoever knows identifiers."""
        if self.values:
            text = ", ".join(value_words(signal, value) for signal, value in self.values.items())
        else:
            text = f"{listed(self.signals)}: {self.outcome}{f', {self.detail}' if self.detail else ''}"
        return f"{text} ({self.question})"


def value_words(signal: Signal, value: float) -> str:
    """Return a value in SI with its name, in the unit of people."""
    _, amount, unit = for_people(signal.value, value)
    return f"{signal_words(signal)} {digits(amount)} {unit}".rstrip()


def _delay(answer: bytes | None, *, is_busy: bool) -> AskOutcome | None:
    """Return what a controller does instead of an answer, None if that is no delay; who is busy may be silent, too."""
    if answer is None:
        return AskOutcome.BUSY if is_busy else None
    return _LATER.get(answer[2]) if answer[0] == NEGATIVE and len(answer) > 2 else None


class Interview:
    """Asks the controllers of a car for single data; who answers nothing at all is given up, and asked no more.

    Parameters
    ----------
    line
        To the controllers.
    patience_s
        How long a busy controller is asked again [s].
    show
        Tells people why it takes long.
    goes_on
        Called while it waits; False ends that with StoppedError.
    """

    def __init__(self, line: Line, patience_s: float, show: Show, goes_on: Callable[[], bool]) -> None:
        self.given_up: dict[CanAddress, AskOutcome] = {}
        self._line = line
        self.patience_s = patience_s
        self._show = show
        self._goes_on = goes_on
        self._heard: set[CanAddress] = set()
        self._until_s: dict[CanAddress, float] = {}  # of patience with who is busy

    def replies(self, profile: Profile) -> Iterator[CarReply]:
        """Ask for each datum of a profile, and yield what became of that; raises ControllerError, StoppedError."""
        signals = dict[tuple[CanAddress, DatumId], list[Signal]]()
        for signal, asked in profile.asked.items():
            signals.setdefault((address_of(asked), asked.data_id), []).append(signal)
        for (address, datum), named in signals.items():
            yield self._reply(profile, DataRequest(address, (datum,)), tuple(named))
        for signal, pgn in profile.groups.items():
            group = GroupQuestion(pgn)
            is_told = isinstance(self._line, CanLine) and self._line.ask_group(group) is not None
            yield CarReply(question=group, signals=(signal,), outcome=AskOutcome.TOLD if is_told else AskOutcome.SILENT)

    def _reply(self, profile: Profile, question: DataRequest, signals: tuple[Signal, ...]) -> CarReply:
        reply = partial(CarReply, question=question, signals=signals)
        answer = self._ask(question)
        if answer is None:
            return reply(outcome=self.given_up.get(question.address, AskOutcome.SILENT))
        if answer[0] == NEGATIVE:
            return reply(outcome=AskOutcome.REFUSED, detail=refusal_text(answer[2] if len(answer) > 2 else 0))
        (datum,) = question.data
        data = data_in(question.request, answer, question.can_id, sizes_of(profile.asked.values()))
        if isinstance(data, str) or datum not in dict(data):
            return reply(outcome=AskOutcome.UNREADABLE, detail=data if isinstance(data, str) else "left out")
        raw = {signal: profile.asked[signal].value(dict(data)[datum]) for signal in signals}
        values = {
            signal: float(to_si(signal, profile.sources[signal], None)(np.array([float(value)]))[0])
            for signal, value in raw.items()
            if value not in profile.sources[signal].invalid
        }
        return reply(outcome=AskOutcome.TOLD if values else AskOutcome.EMPTY, values=values)

    def _ask(self, question: DataRequest) -> bytes | None:
        """Return the answer to a question; None without, and from a controller that is given up."""
        address, silent_count = question.address, 0
        while address not in self.given_up and silent_count < MOST_SILENT:
            answer = self._line.ask(question.request, address)
            delay = _delay(answer, is_busy=address in self._until_s)
            if delay is not None:
                self._wait_for(address, delay)
            elif answer is not None:
                self._heard.add(address)
                self._until_s.pop(address, None)
                return answer
            else:
                silent_count += 1
        if address not in self._heard:
            self.given_up.setdefault(address, AskOutcome.SILENT)
        return None

    def _wait_for(self, address: CanAddress, delay: AskOutcome) -> None:
        """Wait until a controller that is busy may be asked again, or give it up."""
        if address not in self._until_s:
            self._show(f"{id_text(address.request_id)} is busy: it is asked again for {self.patience_s:g} s at most")
        until_s = self._until_s.setdefault(address, time.monotonic() + self.patience_s)
        if time.monotonic() >= until_s:
            self.given_up[address] = delay
            return
        if not self._goes_on():
            raise StoppedError(STOPPED)
        time.sleep(min(BUSY_PAUSE_S, self.patience_s))
