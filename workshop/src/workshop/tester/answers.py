"""Validity of answers, texts of refusals, timing of the tester (ISO 14229-1, ISO 14229-2)."""

import tomllib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

POSITIVE: Final = 0x40  # added to the service in a positive response
NEGATIVE: Final = 0x7F
PENDING_S: Final = 5.0  # after response pending (78), for data that are polled
MOST_PENDING_S: Final = 30.0  # total time with response pending
LATEST_S: Final = 5.0  # of an answer without "response pending": the longest P2* of a controller (ISO 14229-2)
SUPPRESS: Final = 0x80  # suppressPosRspMsgIndicationBit of a sub-function

BUSY: Final = 0x21
PENDING: Final = 0x78
NOT_SUPPORTED: Final = frozenset({0x11})
ONLY_ELSEWHERE: Final = frozenset({0x7E, 0x7F})  # not supported in the active session

SESSION, CLEAR, READ_TROUBLE, READ_DATA, SECURITY, ROUTINE, TESTER_PRESENT = 0x10, 0x14, 0x19, 0x22, 0x27, 0x31, 0x3E

SERVICE_NAMES: Final[Mapping[int, str]] = {
    SESSION: "DiagnosticSessionControl",
    CLEAR: "ClearDiagnosticInformation",
    READ_TROUBLE: "ReadDTCInformation",
    READ_DATA: "ReadDataByIdentifier",
    SECURITY: "SecurityAccess",
    ROUTINE: "RoutineControl",
    TESTER_PRESENT: "TesterPresent",
}

# Number of request bytes after the service that a positive response repeats.
_REPEATED: Final[Mapping[int, int]] = {
    SESSION: 1, READ_TROUBLE: 1, READ_DATA: 2, SECURITY: 1, ROUTINE: 3, TESTER_PRESENT: 1,
}  # fmt: skip
_WITHOUT_SUB_FUNCTION: Final = frozenset({READ_DATA})

# Least and greatest length of a positive response [byte]; None: unlimited.
_LENGTHS: Final[Mapping[int, tuple[int, int | None]]] = {
    SESSION: (6, 6), CLEAR: (1, 1), READ_DATA: (4, None), ROUTINE: (4, None), TESTER_PRESENT: (2, 2),
}  # fmt: skip
COUNT_BY_MASK, BY_MASK, SNAPSHOTS, EXTENDED, SUPPORTED = 0x01, 0x02, 0x04, 0x06, 0x0A  # sub-functions of service 19
HEAD_BYTES: Final[Mapping[int, int]] = {  # of service 19 by sub-function, before codes and records
    COUNT_BY_MASK: 6, BY_MASK: 3, SNAPSHOTS: 6, EXTENDED: 6, SUPPORTED: 3,
}  # fmt: skip
ROW_BYTES: Final = 4  # a trouble code and its status
_FORMATS: Final = range(5)  # of trouble codes; others are reserved
_NEGATIVE_BYTES: Final = 3
_UNTIMED_BYTES: Final = 2  # of a session response without times, edition of 2006
_LEAST_DOUBLED: Final = 4  # bytes; a shorter half may repeat by chance
_SHOWN_BYTES: Final = 24

_REFUSALS: Final[Mapping[int, str]] = {
    int(code, 16): text for code, text in tomllib.loads((Path(__file__).parent / "refusals.toml").read_text()).items()
}


def refusal_text(code: int) -> str:
    """Return the text of a negative response code, with its number."""
    return f"{_REFUSALS.get(code, 'unknown reason')} ({code:02X})"


def request_text(request: bytes) -> str:
    return request.hex(" ").upper()


def hex_text(response: bytes) -> str:
    """Return a response in hexadecimal, only its beginning if it is long."""
    return request_text(response[:_SHOWN_BYTES]) + (" ..." if len(response) > _SHOWN_BYTES else "")


def belongs(request: bytes, response: bytes) -> bool:
    """Return whether a response belongs to this request.

    A positive response repeats the beginning of the request; of several data, the first identifier.
    """
    if len(response) >= 3 and response[0] == NEGATIVE:
        return response[1] == request[0]
    if not response or response[0] != request[0] + POSITIVE:
        return False
    count = min(_REPEATED.get(request[0], 0), len(request) - 1)
    asked = bytearray(request[1 : 1 + count])
    if asked and request[0] not in _WITHOUT_SUB_FUNCTION:
        asked[0] &= ~SUPPRESS & 0xFF
    return response[1 : 1 + count] == bytes(asked)


def is_pending(request: bytes, response: bytes) -> bool:
    """Return whether a response is "response pending" (78)."""
    return response[:3] == bytes([NEGATIVE, request[0], PENDING])


def is_data_answer(request: bytes, response: bytes) -> bool:
    """Return whether a response is a refusal, or begins with one of the requested data.

    It need not be the first: a controller leaves out unsupported data (ISO 14229-1).
    """
    width = 2 if request[0] == READ_DATA else 1
    asked = {request[at : at + width] for at in range(1, len(request), width)}
    if response[:1] == bytes([request[0] + POSITIVE]):
        return response[1 : 1 + width] in asked
    return response[:2] == bytes([NEGATIVE, request[0]])


class OpenRequests:
    """Requests to one controller that wait for an answer, so that a late one is not taken for that of the next request.

    A controller answers in order. A refusal names a service and no data: it belongs to the oldest open request.

    Parameters
    ----------
    belongs
        Whether a response can be that to a request.
    """

    def __init__(self, belongs: Callable[[bytes, bytes], bool]) -> None:
        self._belongs = belongs
        self._open: list[tuple[bytes, float]] = []  # with the time of each

    def begin(self, request: bytes, now_s: float) -> None:
        """Add a request; what was not answered for long is lost."""
        waiting = [(earlier, sent_s) for earlier, sent_s in self._open if now_s - sent_s < LATEST_S]
        self._open = [*waiting, (request, now_s)]

    def answered_by(self, response: bytes) -> bytes | None:
        """Return the request that a response answers, which is open no more; None: it answers none."""
        for at, (request, _) in enumerate(self._open):
            if self._belongs(request, response):
                first = at if response[0] == NEGATIVE else 0  # data prove that all before is answered, or lost
                del self._open[first : at + 1]
                return request
        return None


def fault(request: bytes, response: bytes) -> str:
    """Return how a response that belongs to a request violates ISO 14229-1, empty if it does not."""
    if response[0] == NEGATIVE:
        if len(response) == _NEGATIVE_BYTES and not response[2]:
            return "it is negative and gives no reason"
        return _length_fault(response, _NEGATIVE_BYTES, _NEGATIVE_BYTES)
    half = len(response) // 2
    if half >= _LEAST_DOUBLED and response[:half] == response[half:]:
        return "it holds the same answer twice"
    if request[0] == READ_TROUBLE:
        return _trouble_fault(request, response)
    if request[0] == SESSION and len(response) == _UNTIMED_BYTES:
        return ""
    least, most = _LENGTHS.get(request[0], (1, None))
    if request[0] == SECURITY:
        least, most = (3, None) if request[1] % 2 else (2, 2)  # a seed; an accepted key
    return _length_fault(response, least, most)


def _length_fault(response: bytes, least: int, most: int | None) -> str:
    if least <= len(response) and (most is None or len(response) <= most):
        return ""
    due = f"{least}" if least == most else f"at least {least}"
    return f"{due} {'byte is' if most == 1 else 'bytes are'} due, and it has {len(response)}"


def _trouble_fault(request: bytes, response: bytes) -> str:
    kind = response[1]
    head = HEAD_BYTES.get(kind, 2)
    if length_fault := _length_fault(response, head, head if kind == COUNT_BY_MASK else None):
        return length_fault
    if kind in {SNAPSHOTS, EXTENDED} and response[2:5] != request[2:5]:
        return f"it is about {request_text(response[2:5])}, not about {request_text(request[2:5])}"
    if kind == COUNT_BY_MASK and response[3] not in _FORMATS:
        return f"its trouble codes have the unknown format {response[3]:02X}"
    if kind == BY_MASK and not response[2] & request[2]:
        return f"the controller keeps none of the status bits that were asked for, only {response[2]:02X}"
    return _rows_fault(response[head:]) if kind in {BY_MASK, SUPPORTED} else ""


def _rows_fault(rows: bytes) -> str:
    if len(rows) % ROW_BYTES:
        return "its last trouble code is cut off"
    codes = [rows[place : place + ROW_BYTES] for place in range(0, len(rows), ROW_BYTES)]
    numbers = [code[:-1] for code in codes if any(code)]  # zeros are padding
    if not all(map(any, numbers)):
        return "it names the trouble code 000000, which is none"
    return "it names a trouble code twice" if len(set(numbers)) < len(numbers) else ""


DEFAULT_SESSION: Final = 0x01
STOPPED: Final = "stopped early: not everything was asked"


@dataclass(frozen=True, slots=True, kw_only=True)
class TesterTiming:
    """Times and counts of a tester (ISO 14229-2): how long it waits, how soon and how often it asks again."""

    p2_s: float = 1.0  # until an answer begins: 0.05 s of the controller, and the way
    p2_star_s: float = 6.0  # after response pending (78)
    longest_s: float = 60.0  # of one request, response pending included
    gap_s: float = 0.01  # between an answer and the next request
    busy_pause_s: float = 0.1  # after 21; doubled each time
    most_busy: int = 6
    most_silent: int = 2  # unanswered attempts of one request


@dataclass(slots=True)
class DialogueCounts:
    """Counts of a dialogue."""

    requests: int = 0
    refusals: int = 0
    busy: int = 0  # answered 21
    silent: int = 0  # not answered in time
    stray: int = 0  # messages that belong to no request
