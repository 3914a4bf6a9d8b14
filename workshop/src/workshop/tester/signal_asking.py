"""Requests for the asked signals of a profile while the bus is diagnosed; the answers are read from the bus.

Services 22, 01 and 21 are sent, 2C where the profile allows it, and requests for parameter groups of J1939: nothing
that changes a controller, no session. Nothing is sent while there is another tester.
"""

import asyncio
import logging
import math
import time
from collections import Counter, deque
from collections.abc import AsyncIterator, Callable, Mapping, Sequence
from contextlib import AbstractContextManager, asynccontextmanager
from dataclasses import dataclass, field
from itertools import groupby
from typing import Final

from canlog.errors import NOTICE, CanlogError
from diag_service.diagnosis.columns import Signal
from diag_service.errors import ConfigError, ControllerError, DiagServiceError, StoppedError
from diag_service.mapping.asked_signals import (
    BY_IDENTIFIER,
    DEFINE_DATA,
    FORGET,
    NEGATIVE,
    POSITIVE,
    READ_DATA,
    READ_LOCAL,
    AskedField,
    DatumId,
    data_in,
    sizes_of,
)
from diag_service.mapping.profile import AskingRules
from diag_service.settings.config import BusConfig
from workshop.tester.adapters import Line, line_through, rules_through
from workshop.tester.addresses import (
    GROUP_REQUEST,
    CanAddress,
    id_text,
    is_extended,
)
from workshop.tester.answers import (
    BUSY,
    is_pending,
    refusal_text,
)
from workshop.tester.asking import AskingThread
from workshop.tester.can_line import CanLine, GroupQuestion, OtherTesterError, line_on

MOST_LOAD: Final = 0.05  # bus load by requests and answers
USUAL_BITRATE: Final = 500_000
FIRST_DEFINED: Final = 0xF300  # first number that testers may define (ISO 14229-1, annex C)
MOST_DEFINITIONS: Final = 3  # attempts between two sets: a reset deletes them
DEFINE_AGAIN_S: Final = 60.0  # period at which they are repeated, for logs that begin later
FRAME_BITS, LONG_FRAME_BITS = 125, 150  # of a frame of eight bytes with stuff bits; with 29 bits
FIRST_SLOW: Final = 4  # first requests without delay: so many messages are needed for validity
SLOW_S: Final = 1.0  # period of slow quantities
GROUP_S: Final = 0.5  # SAE J1939-21: at most two or three requests for a group a second
REST_S: Final = 0.05  # pause while nothing is due
BUSY_PAUSE_S: Final = 0.1
NOT_NOW: Final = frozenset({0x22, 0x24, 0x26, *range(0x81, 0x94)})  # refusals by the present state (ISO 14229-1)
AGAIN_S: Final = 10.0  # until such data are asked for again
MOST_SILENT: Final = 3  # consecutive requests without an answer, or with an invalid one
FIRST_PAUSE_S: Final = 1.0
LONGEST_PAUSE_S: Final = 16.0  # between attempts at a controller that does not answer
LEAST_ROWS: Final = 5  # samples of a slip phase that an estimate needs
RATE_S: Final = 10.0  # over which the rate is measured
LOGGED_RATIO: Final = 0.3  # change of the rate that is logged
NO_GROUPS: Final = "parameter groups of J1939 are asked for on a bus, not through an adapter"
_SLOW: Final = frozenset({Signal.SUMP_TEMPERATURE, Signal.AMBIENT_TEMPERATURE, Signal.ODOMETER})
_LOG: Final = logging.getLogger(__name__)


OpenLine = Callable[[], AbstractContextManager[Line]]


def address_of(asked: AskedField) -> CanAddress:
    return CanAddress(request_id=asked.request_id, response_id=asked.reply_id)


@dataclass(frozen=True, slots=True)
class DataRequest:
    """Data of one request."""

    address: CanAddress
    data: tuple[DatumId, ...]

    @property
    def can_id(self) -> int:
        return self.address.request_id

    @property
    def request(self) -> bytes:
        width = 2 if self.data[0].service == READ_DATA else 1
        return bytes([self.data[0].service]) + b"".join(datum.number.to_bytes(width) for datum in self.data)

    def __str__(self) -> str:
        return ", ".join(map(str, self.data))


@dataclass(frozen=True, slots=True)
class Definition:
    """A datum defined from others (service 2C)."""

    address: CanAddress
    parts: tuple[DatumId, ...]

    @staticmethod
    def forgetting(number: int) -> bytes:
        """Return the request that deletes an earlier definition, to which this one would be appended."""
        return bytes([DEFINE_DATA, FORGET]) + number.to_bytes(2)

    def request(self, number: int, sizes: Mapping[DatumId, int]) -> bytes:
        """Return the request that defines it from all bytes of each part."""
        parts = (part.number.to_bytes(2) + bytes([1, sizes[part]]) for part in self.parts)
        return bytes([DEFINE_DATA, BY_IDENTIFIER]) + number.to_bytes(2) + b"".join(parts)


@dataclass(slots=True)
class PollPlan:
    """The requests of each round: fast quantities always, slow ones by period, bundled as the controller accepts."""

    fields: Mapping[Signal, AskedField]
    rules: AskingRules = field(default_factory=AskingRules)
    groups: Sequence[int] = ()
    defined: dict[DatumId, Definition] = field(default_factory=dict)
    refused: set[DatumId] = field(default_factory=set)
    _fewer: int | None = None  # identifiers at once, after a refusal
    _for_now: set[DatumId] = field(default_factory=set)  # of those refused
    _again_s: float = math.inf  # time at which these are asked for again
    _slow_s: float = 0.0
    _slow_count: int = 0
    _group_s: float = 0.0

    @property
    def addresses(self) -> set[CanAddress | GroupQuestion]:
        return {GroupQuestion(pgn) for pgn in self.groups} | {
            address_of(asked) for asked in self.fields.values() if asked.data_id not in self.refused
        }

    @property
    def fast(self) -> list[DataRequest]:
        parts = {part for definition in self.defined.values() for part in definition.parts}
        return [
            *(DataRequest(definition.address, (datum,)) for datum, definition in self.defined.items()),
            *self._questions([asked for asked in self._fast_fields() if asked.data_id not in parts]),
        ]

    def definitions(self) -> dict[DatumId, Definition]:
        """Return the definitions of one datum for each controller with several fast data."""
        by_address: dict[CanAddress, dict[DatumId, None]] = {}
        for asked in self._fast_fields():
            if asked.service == READ_DATA and asked.data_id not in self.refused:
                by_address.setdefault(address_of(asked), {})[asked.data_id] = None
        return {
            DatumId(address.request_id, READ_DATA, FIRST_DEFINED): Definition(address, tuple(parts))
            for address, parts in by_address.items()
            if len(parts) > 1
        }

    def _fast_fields(self) -> list[AskedField]:
        return [asked for signal, asked in self.fields.items() if signal not in _SLOW]

    def due(self, now_s: float) -> list[DataRequest | GroupQuestion]:
        if now_s >= self._again_s:
            self.refused -= self._for_now
            self._for_now.clear()
            self._fewer, self._again_s = None, math.inf
        questions: list[DataRequest | GroupQuestion] = [*self.fast]
        if self.groups and now_s >= self._group_s:
            self._group_s = now_s + GROUP_S
            questions += map(GroupQuestion, self.groups)
        if now_s >= self._slow_s:
            self._slow_count += 1
            self._slow_s = now_s + (SLOW_S if self._slow_count > FIRST_SLOW else 0.0)
            questions += self._questions([asked for signal, asked in self.fields.items() if signal in _SLOW])
        return questions

    def begin(self) -> None:
        """Reset refusals and bundling."""
        self.refused.clear()
        self._for_now.clear()
        self._fewer, self._again_s = None, math.inf

    def refuse(self, question: DataRequest, why: str, *, for_now: bool = False) -> str:
        """Reduce the bundling, or leave out a single datum, for ever or for now; return a line for the log."""
        if for_now:
            self._again_s = min(self._again_s, time.monotonic() + AGAIN_S)
        if len(question.data) > 1:
            self._fewer = max(1, len(question.data) // 2)
            return (
                f"{id_text(question.address.request_id)} does not take {len(question.data)} identifiers at once: {why}"
            )
        self.refused.add(question.data[0])
        if for_now:
            self._for_now.add(question.data[0])
        return f"{question} is not told ({why}), and {'asked for again later' if for_now else 'left out'}"

    def _questions(self, fields: Sequence[AskedField]) -> list[DataRequest]:
        addresses = {asked.data_id: address_of(asked) for asked in fields}
        data = [datum for datum in addresses if datum not in self.refused]
        requests: list[DataRequest] = []
        for _, group in groupby(data, key=lambda datum: (datum.request_id, datum.service)):
            batch = list(group)
            width = 1 if batch[0].service == READ_LOCAL else self._fewer or self.rules.together  # OBD takes six on CAN
            requests += [
                DataRequest(addresses[batch[at]], tuple(batch[at : at + width])) for at in range(0, len(batch), width)
            ]
        return requests


def frame_count(payload_bytes: int) -> int:
    """Return the number of frames of a message with its flow control."""
    return 1 if payload_bytes <= 7 else 2 + -(-(payload_bytes - 6) // 7)


class SignalAsker(AskingThread):
    """Asks for signals in a thread while entered.

    Parameters
    ----------
    fields, rules, groups
        Signals, limits of the controllers, and parameter groups of J1939.
    open_line
        Opens the controllers once there is no other tester; raises SourceError, ControllerError.
    bitrate
        Of the bus [bit/s], of which ``MOST_LOAD`` is used; None: ``USUAL_BITRATE``.
    """

    def __init__(
        self,
        fields: Mapping[Signal, AskedField],
        rules: AskingRules,
        open_line: OpenLine,
        bitrate: int | None = None,
        groups: Sequence[int] = (),
    ) -> None:
        super().__init__("signal asker")
        self.plan = PollPlan(fields, rules, groups)
        self._definitions_left = 0
        self._define_at_s = 0.0
        self._odd: Counter[tuple[DatumId, ...]] = Counter()  # consecutive invalid answers
        self.sent: Counter[int] = Counter()  # requests by service; for groups by `GROUP_REQUEST`
        self.set_count = 0
        self._sizes = sizes_of(fields.values())
        self._open_line = open_line
        self._bits_per_s = MOST_LOAD * (bitrate or USUAL_BITRATE)
        self._free_s = 0.0  # time of the next request
        self._silent: Counter[CanAddress | GroupQuestion] = Counter()  # consecutive requests without an answer
        self._silent_until_s: dict[CanAddress | GroupQuestion, float] = {}
        self._trouble, self._pause_s = "", FIRST_PAUSE_S
        self._logged: set[str] = set()  # lines about refusals, which recur after each opening
        self._sets: deque[float] = deque(maxlen=10_000)
        self._logged_hz: float | None = None

    def _run(self) -> None:
        while self.goes_on:
            try:
                with self._open_line() as line:
                    self._rounds(line)
            except StoppedError:
                return
            except OtherTesterError as exc:
                _LOG.log(NOTICE, "%s: nothing is asked until it is silent; its answers are read", exc)
                self._trouble = str(exc)
            except (CanlogError, DiagServiceError) as exc:
                if str(exc) != self._trouble:
                    _LOG.warning("asking is interrupted: %s; trying again", exc)
                self._trouble = str(exc)
                self._is_over.wait(self._pause_s)
                self._pause_s = min(2.0 * self._pause_s, LONGEST_PAUSE_S)
            self._sets.clear()

    def _rounds(self, line: Line) -> None:
        self._silent.clear()
        self._odd.clear()
        self.plan.begin()
        self._forget_definitions()
        self._definitions_left = MOST_DEFINITIONS if self.plan.rules.define else 0
        while self.goes_on:
            if self.plan.defined and time.monotonic() >= self._define_at_s:
                self._forget_definitions()
            if self._definitions_left and not self.plan.defined:
                self._define(line)
                self._define_at_s = time.monotonic() + DEFINE_AGAIN_S
            questions = self.plan.due(time.monotonic())
            if not self.plan.addresses:
                raise ControllerError("everything that the profile asks for is refused")
            due = [
                question
                for question in questions
                if self._silent_until_s.get(question.address, 0.0) <= time.monotonic()
            ]
            if not due:
                self._is_over.wait(REST_S)
            answered = [self._ask(line, question) for question in due]
            if answered and all(answered):
                if self._trouble:
                    _LOG.log(NOTICE, "asking goes on")
                    self._trouble, self._pause_s = "", FIRST_PAUSE_S
                self.set_count += 1
                if self.plan.defined:
                    self._definitions_left = MOST_DEFINITIONS
                self._sets.append(time.monotonic())
                self._log_rate()

    def _forget_definitions(self) -> None:
        for datum in self.plan.defined:
            del self._sizes[datum]
        self.plan.defined.clear()

    def _define(self, line: Line) -> None:
        """Define one datum of a round per controller; without a definition the data are read one by one."""
        self._definitions_left -= 1
        for datum, definition in self.plan.definitions().items():
            self._send(line, definition.forgetting(datum.number), definition.address, 1)  # refused if there is none
            answer = self._send(line, definition.request(datum.number, self._sizes), definition.address, 4)
            if answer is not None and answer[0] == DEFINE_DATA + POSITIVE:
                self.plan.defined[datum] = definition
                self._sizes[datum] = sum(self._sizes[part] for part in definition.parts)
            elif answer is not None and not self._definitions_left:
                why = refusal_text(answer[2] if len(answer) > 2 else 0)
                _LOG.log(NOTICE, "%s makes no datum of others: %s", id_text(definition.address.request_id), why)

    def _send(
        self, line: Line, request: bytes, address: CanAddress | GroupQuestion, expected_bytes: int
    ) -> bytes | None:
        """Return the answer to a request within the bus load; None: no answer, or it was stopped."""
        self._is_over.wait(max(0.0, self._free_s - time.monotonic()))
        if not self.goes_on:
            return None
        begun_s = time.monotonic()
        if isinstance(address, GroupQuestion):
            self.sent[GROUP_REQUEST] += 1
            answer = line.ask_group(address) if isinstance(line, CanLine) else None
            bits = 2 * LONG_FRAME_BITS
        else:
            self.sent[request[0]] += 1
            answer = line.ask(request, address)
            frames = frame_count(len(request)) + frame_count(expected_bytes if answer is None else len(answer))
            bits = frames * (LONG_FRAME_BITS if is_extended(address.request_id) else FRAME_BITS)
        self._free_s = begun_s + bits / self._bits_per_s
        return answer

    def _ask(self, line: Line, question: DataRequest | GroupQuestion) -> bool:
        """Ask once; return whether the answer has data."""
        request, expected = question.request, 0
        if isinstance(question, DataRequest):
            expected = 1 + sum(self._sizes[datum] + (len(request) - 1) // len(question.data) for datum in question.data)
        answer = self._send(line, request, question.address, expected)
        if answer is None and not self.goes_on:
            return False
        if answer is None or is_pending(request, answer):
            self._leave_alone(question.address)
            return False
        self._silent[question.address] = 0
        if self._silent_until_s.pop(question.address, None) is not None:
            _LOG.log(NOTICE, "%s answers", question.address)
        if isinstance(question, GroupQuestion):
            return True
        if answer[0] == request[0] + POSITIVE:
            return self._has_data(question, answer)
        code = answer[2] if answer[0] == NEGATIVE and len(answer) > 2 else 0
        if code == BUSY:
            self._log_once(f"{id_text(question.can_id)} is busy (21): it is asked again")
            self._free_s = time.monotonic() + BUSY_PAUSE_S
        elif question.data[0] in self.plan.defined:
            _LOG.log(NOTICE, "%s is not there any more (%s): it is defined anew", question, refusal_text(code))
            self._forget_definitions()
        else:
            self._log_once(self.plan.refuse(question, refusal_text(code), for_now=code in NOT_NOW))
        return False

    def _log_once(self, text: str) -> None:
        if text not in self._logged:
            self._logged.add(text)
            _LOG.log(NOTICE, "%s", text)

    def _leave_alone(self, address: CanAddress | GroupQuestion) -> None:
        """Pause the requests to a silent controller; raises ControllerError if all are silent."""
        self._silent[address] += 1
        if self._silent[address] < MOST_SILENT:
            return
        self._silent[address] = 0
        is_new = address not in self._silent_until_s
        self._silent_until_s[address] = time.monotonic() + LONGEST_PAUSE_S
        if self._silent_until_s.keys() >= self.plan.addresses:
            self._silent_until_s.clear()
            raise ControllerError(f"{address} does not answer")
        if is_new:
            _LOG.warning("%s does not answer: it is asked now and then", address)

    def _has_data(self, question: DataRequest, answer: bytes) -> bool:
        """Return whether an answer has the requested data, with the lengths of the profile."""
        data = data_in(question.request, answer, question.address.request_id, self._sizes)
        if isinstance(data, str):
            self._odd[question.data] += 1
            if self._odd[question.data] >= MOST_SILENT:  # a single one may be a late answer
                self._log_once(self.plan.refuse(question, data))
            return False
        self._odd.pop(question.data, None)
        for datum in set(question.data) - dict(data).keys():
            self._log_once(self.plan.refuse(DataRequest(question.address, (datum,)), "left out"))
        return bool(data)

    def _log_rate(self) -> None:
        first_s, last_s = self._sets[0], self._sets[-1]
        if last_s - first_s < RATE_S:
            return
        rate_hz = (len(self._sets) - 1) / (last_s - first_s)
        self._sets.clear()
        if self._logged_hz is None or abs(rate_hz / self._logged_hz - 1.0) > LOGGED_RATIO:
            self._logged_hz = rate_hz
            _LOG.log(
                NOTICE,
                "all values come %.0f times a second: enough where a clutch slips for %.2g s",
                rate_hz,
                LEAST_ROWS / rate_hz,
            )


@asynccontextmanager
async def asking(
    bus: BusConfig, fields: Mapping[Signal, AskedField], rules: AskingRules, groups: Sequence[int] = ()
) -> AsyncIterator[None]:
    """Ask for signals until the block ends; raises ConfigError."""
    addresses = [address_of(asked) for asked in fields.values()]
    open_line: OpenLine
    if bus.adapter is not None:
        adapter, channel = bus.adapter, bus.channel or ""
        if groups:
            raise ConfigError(NO_GROUPS)
        rules = rules_through(adapter, rules)
        open_line = lambda: line_through(adapter, channel, lambda: asker.goes_on)  # noqa: E731 - one of two
    else:
        open_line = lambda: line_on(bus, addresses, groups, is_fd=bus.is_fd, goes_on=lambda: asker.goes_on)  # noqa: E731
    asker = SignalAsker(fields, rules, open_line, bus.bitrate, groups)
    with asker:
        try:
            yield
        finally:
            await asyncio.to_thread(asker.end)
