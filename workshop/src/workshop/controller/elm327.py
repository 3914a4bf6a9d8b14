"""An ELM327 adapter without I/O: settings and a typed line in, output lines out."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, Final

from canlog.isotp import segments
from workshop.controller.iso14229 import NEGATIVE, Nrc
from workshop.controller.table import Addressing, Transport

VERSION: Final = "ELM327 v1.5"
DESCRIPTION: Final = "OBDII to RS232 Interpreter"
VOLTAGE: Final = "12.6V"  # no signal of the vehicle has it
OK: Final = "OK"
UNKNOWN: Final = "?"
MONITOR: Final = "MA"
AUTOMATIC: Final = 0x0
CAN_11_500: Final = 0x6
CAN_29_500: Final = 0x7
CAN_11_250: Final = 0x8
CAN_29_250: Final = 0x9
PROTOCOLS: Final[Mapping[int, str]] = MappingProxyType({
    AUTOMATIC: "AUTO",
    0x1: "SAE J1850 PWM",
    0x2: "SAE J1850 VPW",
    0x3: "ISO 9141-2",
    0x4: "ISO 14230-4 (KWP 5BAUD)",
    0x5: "ISO 14230-4 (KWP FAST)",
    CAN_11_500: "ISO 15765-4 (CAN 11/500)",
    CAN_29_500: "ISO 15765-4 (CAN 29/500)",
    CAN_11_250: "ISO 15765-4 (CAN 11/250)",
    CAN_29_250: "ISO 15765-4 (CAN 29/250)",
    0xA: "SAE J1939 (CAN 29/250)",
    0xB: "USER1 (CAN 11/125)",
    0xC: "USER2 (CAN 11/50)",
})  # fmt: skip
ALL_ID_BITS: Final = 0x1FFFFFFF
LARGEST_STANDARD_ID: Final = 0x7FF
_DEFAULT_PRIORITY: Final = 0x18
_PRIORITY_BITS: Final = 0x1F
_HEADER_BITS: Final = 0xFFFFFF  # of three bytes, behind the priority


@dataclass(frozen=True, slots=True, kw_only=True)
class Settings:
    """Settings of an adapter since its start."""

    echoes: bool = True
    has_line_feeds: bool = False
    has_spaces: bool = True
    shows_headers: bool = False
    shows_length: bool = False
    is_formatted: bool = True  # the adapter handles the protocol bytes of ISO-TP
    shows_responses: bool = True
    header: int | None = None  # of requests, three bytes; None: functional
    priority: int = _DEFAULT_PRIORITY  # the first byte of a header of 29 bits
    extended_address: int | None = None  # the byte before those of ISO-TP
    receive_id: int | None = None  # None: identifiers of OBD responses
    receive_mask: int = ALL_ID_BITS
    protocol: int = AUTOMATIC
    is_automatic: bool = True

    def takes(self, can_id: int) -> bool:
        """Return whether frames with this identifier are shown as responses."""
        if self.receive_id is not None:
            return can_id & self.receive_mask == self.receive_id & self.receive_mask
        return 0x7E8 <= can_id <= 0x7EF or can_id & 0x1FFFFF00 == 0x18DAF100

    @property
    def protocol_name(self) -> str:
        """The protocol as ``AT DP`` shows it."""
        name = PROTOCOLS[self.protocol]
        return f"AUTO, {name}" if self.is_automatic and self.protocol != AUTOMATIC else name

    @property
    def protocol_number(self) -> str:
        """The protocol as ``AT DPN`` shows it."""
        return f"{'A' if self.is_automatic else ''}{self.protocol:X}"


_SWITCHES: Final[Mapping[str, str]] = {
    "E": "echoes", "L": "has_line_feeds", "S": "has_spaces", "H": "shows_headers", "D": "shows_length",
    "R": "shows_responses", "CAF": "is_formatted",
}  # fmt: skip
_NO_MATTER: Final = re.compile(
    r"AL|NL|AT[012]|ST[0-9A-F]{2}|CTM[15]|M[01]|V[01]|CSM[01]|LP|SS|BI|FE|STPX|JE|JS|JHF[01]|JTM[15]|PP[0-9A-F]{2}OFF"
    r"|IB(10|12|15|48|96)|IIA[0-9A-F]{2}|KW[01]|SW[0-9A-F]{2}|WM([0-9A-F]{2}){1,6}|(TA|RA|SR)[0-9A-F]{2}"
    r"|CFC[01]|FCSM[012]|FCSH([0-9A-F]{3}|[0-9A-F]{6}|[0-9A-F]{8})|FCSD([0-9A-F]{2}){1,5}"
)
"""Commands that are accepted without effect: time limits, other buses, flow control, which is always automatic."""


_Changed = dict[str, Any] | None  # settings with their new values; None: there is no such command
_LINES: Final[Mapping[str, str]] = {
    "I": VERSION, "@1": DESCRIPTION, "RV": VOLTAGE, "IGN": "ON", "CS": "T:00 R:00", MONITOR: MONITOR,
}  # fmt: skip


def apply_command(settings: Settings, command: str) -> tuple[Settings, str]:
    """Return the settings after a command, and its output line.

    The command is in capitals, without blanks and without ``AT``.
    """
    lines = {**_LINES, "DP": settings.protocol_name, "DPN": settings.protocol_number}
    if command in lines:
        return settings, lines[command]
    if command in {"Z", "WS"}:
        return Settings(), VERSION
    if command == "D":  # defaults, but for the protocol
        return Settings(protocol=settings.protocol, is_automatic=settings.is_automatic), OK
    if _NO_MATTER.fullmatch(command):
        return settings, OK
    for pattern, change in _CHANGES:
        if match := re.fullmatch(pattern, command):
            changed = change(settings, match)
            return (settings, UNKNOWN) if changed is None else (replace(settings, **changed), OK)
    return settings, UNKNOWN


def _protocol(_settings: Settings, match: re.Match[str]) -> _Changed:
    """Choose a protocol; with an A before it the adapter searches for another one if it is wrong."""
    if match[1] == "A" and not match[2]:  # protocol A, not automatic
        return {"protocol": 0xA, "is_automatic": False}
    if not match[2]:
        return None
    number = int(match[2], 16)
    is_automatic = bool(match[1]) or number == AUTOMATIC
    return {"protocol": AUTOMATIC if is_automatic else number, "is_automatic": is_automatic}


def _header(settings: Settings, match: re.Match[str]) -> _Changed:
    """Set the header of requests: three digits, or six; of eight the first two are the priority."""
    number = int(match[1], 16)
    priority = number >> 24 & _PRIORITY_BITS if len(match[1]) == 8 else settings.priority
    return {"header": number & _HEADER_BITS, "priority": priority}


def _receive_address(_settings: Settings, match: re.Match[str]) -> _Changed:
    """Show responses with this identifier only; X is any digit; without digits those of OBD."""
    digits = match[1]
    if not digits:
        return {"receive_id": None, "receive_mask": ALL_ID_BITS}
    mask = int("".join("0" if digit == "X" else "F" for digit in digits), 16)
    number = int(digits.replace("X", "0"), 16)
    return {"receive_id": number, "receive_mask": mask | ~((1 << 4 * len(digits)) - 1)}


_CHANGES: Final[tuple[tuple[str, Callable[[Settings, re.Match[str]], _Changed]], ...]] = (
    (r"(E|L|S|H|D|R|CAF)([01])", lambda _, match: {_SWITCHES[match[1]]: match[2] == "1"}),
    (r"[ST]P(A?)(00|[0-9A-C]|)", _protocol),
    (r"PC", lambda settings, _: {"protocol": AUTOMATIC} if settings.is_automatic else {}),
    (r"SH([0-9A-F]{3}|[0-9A-F]{6}|[0-9A-F]{8})", _header),
    (r"CP([0-9A-F]{2})", lambda _, match: {"priority": int(match[1], 16) & _PRIORITY_BITS}),
    (r"CEA([0-9A-F]{2}|)", lambda _, match: {"extended_address": int(match[1], 16) if match[1] else None}),
    (r"(?:CRA|AR)([0-9A-FX]{3}|[0-9A-FX]{8}|)", _receive_address),
    (r"CF([0-9A-F]{3}|[0-9A-F]{8})", lambda _, match: {"receive_id": int(match[1], 16)}),
    (
        r"CM([0-9A-F]{3}|[0-9A-F]{8})",
        lambda settings, match: {"receive_mask": int(match[1], 16), "receive_id": settings.receive_id or 0},
    ),
)


SEARCHING: Final = "SEARCHING..."
NO_DATA: Final = "NO DATA"
UNABLE: Final = "UNABLE TO CONNECT"
MOST_RAW_BYTES: Final = 8
HALF_BITRATE: Final = 250_000
_IS_ANYBODY_THERE: Final = b"\x01\x00"
_ON_CAN: Final = range(0x6, 0x10)
_ON_K_LINE: Final = range(0x3, 0x6)

Ask = Callable[[bytes, bool], bytes | None]  # request, is functional; response
MOST_SINGLE_BYTES: Final = 7


def _filled(frame: bytes, padding: int | None) -> bytes:
    """Return a padded frame; unchanged without padding."""
    return frame if padding is None else frame.ljust(MOST_RAW_BYTES, bytes([padding]))


def format_frames(frames: Sequence[bytes], can_id: int, settings: Settings) -> list[str]:
    """Return frames as output lines, by the settings."""
    if settings.shows_headers or not settings.is_formatted:
        return [
            format_frame(can_id, _unpadded(frame) if settings.is_formatted else frame, settings, len(frame))
            for frame in frames
        ]
    head = frames[0]
    if head[0] >> 4 == 0:
        return [_spaced(_unpadded(head)[1:], settings)]
    colon = ": " if settings.has_spaces else ":"
    pieces = [head[2:], *(frame[1:] for frame in frames[1:])]
    length = int.from_bytes(head[:2], "big") & 0xFFF
    return [f"{length:03X}"] + [
        f"{place & 0xF:X}{colon}{_spaced(piece, settings)}" for place, piece in enumerate(pieces)
    ]


def format_frame(can_id: int, data: bytes, settings: Settings, length: int) -> str:
    """Return a frame as an output line; ``length`` is that of the frame with its padding [byte]."""
    if not settings.shows_headers:
        return _spaced(data, settings)
    is_standard = can_id <= LARGEST_STANDARD_ID
    header = f"{can_id:03X}" if is_standard else _spaced(can_id.to_bytes(4, "big"), settings).rstrip()
    parts = [header, *([f"{length:X}"] if settings.shows_length else [])]
    blank = " " if settings.has_spaces else ""
    return blank.join([*parts, _spaced(data, settings)])


def _unpadded(frame: bytes) -> bytes:
    """Return a single frame without padding; other frames unchanged."""
    return frame[: 1 + frame[0]] if frame[0] >> 4 == 0 else frame


def _spaced(data: bytes, settings: Settings) -> str:
    """Return bytes as digits, each followed by a blank, the last one too, unless blanks are off."""
    return "".join(f"{byte:02X} " for byte in data) if settings.has_spaces else data.hex().upper()


@dataclass(frozen=True, slots=True, kw_only=True)
class ElmReply:
    """The reply to a line."""

    lines: tuple[str, ...] = ()
    monitors: bool = False  # whether frames of the bus follow
    awaited: int | None = None  # service whose final response follows
    is_from_car: bool = False  # whether the vehicle was asked


class Interpreter:
    """The adapter of one client.

    Parameters
    ----------
    addressing, transport
        CAN identifiers and ISO-TP of the controller, which alone may need patience.
    ask
        Asks the controller.
    bitrate
        Of the bus [bit/s]; None: 500,000.
    others
        Identifiers of further controllers, which have the same ISO-TP and protocol, and what asks them.
    """

    def __init__(
        self,
        addressing: Addressing,
        transport: Transport,
        ask: Ask,
        bitrate: int | None = None,
        others: Mapping[Addressing, Ask] = MappingProxyType({}),
    ) -> None:
        self.settings = Settings()
        self._ids = addressing
        self._transport = transport
        self._ask = ask
        self._controllers = {addressing: ask, **others}
        self._is_standard = addressing.response_id <= LARGEST_STANDARD_ID
        slow, fast = (CAN_11_250, CAN_11_500) if self._is_standard else (CAN_29_250, CAN_29_500)
        self._protocol = slow if bitrate == HALF_BITRATE else fast
        self._last = ""

    def execute(self, text: str) -> ElmReply:
        """Return the reply to a line; an empty line repeats the last one."""
        words = re.sub(r"\s", "", text).upper() or self._last
        self._last = words
        if not words:
            return ElmReply()
        if words.startswith("AT"):
            self.settings, line = apply_command(self.settings, words[2:])
            return ElmReply(monitors=True) if line == MONITOR else ElmReply(lines=(line,))
        if re.fullmatch(r"[0-9A-F]{2,}", words):
            data = bytes.fromhex(words[: len(words) & ~1])  # an odd last digit is the expected number of answers
            return replace(self._execute_request(data), is_from_car=True)
        return ElmReply(lines=(UNKNOWN,))

    def _execute_request(self, data: bytes) -> ElmReply:
        if len(data) > (MOST_SINGLE_BYTES if self.settings.is_formatted else MOST_RAW_BYTES):
            return ElmReply(lines=(UNKNOWN,))
        if self.settings.protocol == AUTOMATIC:
            return self._search_protocol(data)
        if self.settings.protocol != self._protocol:
            return ElmReply(lines=(self._wrong_bus(),))
        return self._send(data)

    def _search_protocol(self, data: bytes) -> ElmReply:
        """Search the protocol of the vehicle and send."""
        answer = self._send(data)
        if answer.lines == (NO_DATA,) and self._ask(_IS_ANYBODY_THERE, True) is None:
            return ElmReply(lines=(SEARCHING, UNABLE))
        self.settings = replace(self.settings, protocol=self._protocol)
        return replace(answer, lines=(SEARCHING, *answer.lines))

    def _wrong_bus(self) -> str:
        """Return the output on a protocol that the vehicle does not speak."""
        if self.settings.protocol in _ON_CAN:
            return "CAN ERROR"
        return "BUS INIT: ...ERROR" if self.settings.protocol in _ON_K_LINE else NO_DATA

    def _send(self, data: bytes) -> ElmReply:
        if self.settings.is_formatted:
            return self._request(data)
        is_single = 0 < data[0] < len(data)  # the first byte of a single frame is its length
        return self._request(data[1 : 1 + data[0]]) if is_single else ElmReply(lines=(NO_DATA,))

    def _header(self) -> int:
        """Return the identifier of requests; the protocol is known when the header is used, not when it is set."""
        header = self.settings.header
        if header is None:
            return self._ids.functional_id
        return header & LARGEST_STANDARD_ID if self._is_standard else self.settings.priority << 24 | header

    def _request(self, payload: bytes) -> ElmReply:
        header = self._header()
        is_to_all = header == self._ids.functional_id
        if not payload or self.settings.extended_address is not None:
            return ElmReply(lines=(NO_DATA,))
        responses = {
            ids.response_id: response
            for ids, ask in self._controllers.items()
            if header in {ids.functional_id, ids.request_id} and (response := ask(payload, is_to_all)) is not None
        }
        if not self.settings.shows_responses:
            return ElmReply()
        is_pending = bytes([NEGATIVE, payload[0], Nrc.RESPONSE_PENDING]) in responses.values()
        lines = [line for can_id, response in responses.items() for line in self._lines(response, can_id)]
        return ElmReply(lines=tuple(lines) or (NO_DATA,), awaited=payload[0] if is_pending else None)

    def lines(self, response: bytes) -> tuple[str, ...]:
        """Return the output for a response that was awaited."""
        return self._lines(response, self._ids.response_id) or (NO_DATA,)

    def _lines(self, response: bytes, can_id: int) -> tuple[str, ...]:
        if not self.settings.takes(can_id):
            return ()
        frames = [_filled(frame, self._transport.padding) for frame in segments(response)]
        return tuple(format_frames(frames, can_id, self.settings))
