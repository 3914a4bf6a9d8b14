"""What an answer says: whether it belongs to a request, and what a negative one means (ISO 14229-1, annex A)."""

from collections.abc import Mapping
from typing import Final

POSITIVE: Final = 0x40  # added to the service in a positive response
NEGATIVE: Final = 0x7F
SUPPRESS: Final = 0x80  # bit of a sub-function: no positive response is wanted

BUSY: Final = 0x21
PENDING: Final = 0x78
NOT_SUPPORTED: Final = frozenset({0x11})
ONLY_ELSEWHERE: Final = frozenset({0x7E, 0x7F})  # sub-function or service is there in another session

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

# How many bytes after the service a positive response repeats; those of a sub-function without its uppermost bit.
_REPEATED: Final[Mapping[int, int]] = {
    SESSION: 1, READ_TROUBLE: 1, READ_DATA: 2, SECURITY: 1, ROUTINE: 3, TESTER_PRESENT: 1,
}  # fmt: skip
_WITHOUT_SUB_FUNCTION: Final = frozenset({READ_DATA})

_REFUSALS: Final[Mapping[int, str]] = {
    0x10: "general reject",
    0x11: "service not supported",
    0x12: "sub-function not supported",
    0x13: "incorrect length or format",
    0x14: "response too long",
    0x21: "busy, repeat request",
    0x22: "conditions not correct",
    0x24: "request sequence error",
    0x25: "no response from subnet component",
    0x26: "failure prevents execution",
    0x31: "request out of range",
    0x33: "security access denied",
    0x34: "authentication required",
    0x35: "invalid key",
    0x36: "exceeded number of attempts",
    0x37: "required time delay not expired",
    0x70: "upload or download not accepted",
    0x71: "transfer data suspended",
    0x72: "general programming failure",
    0x73: "wrong block sequence counter",
    0x78: "response pending",
    0x7E: "sub-function not supported in active session",
    0x7F: "service not supported in active session",
    0x81: "engine speed too high",
    0x82: "engine speed too low",
    0x83: "engine is running",
    0x84: "engine is not running",
    0x85: "engine run time too low",
    0x86: "temperature too high",
    0x87: "temperature too low",
    0x88: "vehicle speed too high",
    0x89: "vehicle speed too low",
    0x8A: "pedal too high",
    0x8B: "pedal too low",
    0x8C: "transmission not in neutral",
    0x8D: "transmission not in gear",
    0x8F: "brake not closed",
    0x90: "shifter not in park",
    0x91: "torque converter clutch locked",
    0x92: "voltage too high",
    0x93: "voltage too low",
}


def refusal_text(code: int) -> str:
    """Return what a negative response code says, with its number."""
    return f"{_REFUSALS.get(code, 'unknown reason')} ({code:02X})"


def request_text(request: bytes) -> str:
    """Return a request as people write it."""
    return request.hex(" ").upper()


def belongs(request: bytes, response: bytes) -> bool:
    """Return whether a response is one to this request, not a late one to another.

    A positive response repeats how the request began; of several data asked at once, the first.
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
