"""What an ELM327 has been told: settings, and the commands ``AT ...`` that change or show them."""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Final

VERSION: Final = "ELM327 v1.5"
DESCRIPTION: Final = "OBDII to RS232 Interpreter"
VOLTAGE: Final = "12.6V"  # nothing in the vehicle says how high it is
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
    """What an adapter has been told since it was switched on."""

    echoes: bool = True
    has_line_feeds: bool = False
    has_spaces: bool = True
    shows_headers: bool = False
    shows_length: bool = False
    is_formatted: bool = True  # it makes and reads the first bytes of ISO-TP itself
    shows_responses: bool = True
    controls_flow: bool = True
    flow_mode: int = 0  # 0 as usual; 1 header and data below; 2 data below
    flow_header: int | None = None
    flow_data: bytes = b""
    header: int | None = None  # of requests, three bytes; none: to all controllers
    priority: int = _DEFAULT_PRIORITY  # the first byte of a header of 29 bits
    extended_address: int | None = None  # the byte before those of ISO-TP
    receive_id: int | None = None  # none: responses of OBD
    receive_mask: int = ALL_ID_BITS
    protocol: int = AUTOMATIC
    is_automatic: bool = True

    def takes(self, can_id: int) -> bool:
        """Return whether frames with this identifier are shown as responses."""
        if self.receive_id is not None:
            return can_id & self.receive_mask == self.receive_id & self.receive_mask
        return 0x7E8 <= can_id <= 0x7EF or can_id & 0x1FFFFF00 == 0x18DAF100

    def request_id(self, *, is_standard: bool) -> int | None:
        """Return the identifier of requests on a bus of 11 or of 29 bits; None: that of requests to all."""
        return None if self.header is None else self._wire_id(self.header, is_standard=is_standard)

    def flow_id(self, *, is_standard: bool) -> int | None:
        """Return the identifier of flow control that a client makes itself, if it has said which."""
        return None if self.flow_header is None else self._wire_id(self.flow_header, is_standard=is_standard)

    def _wire_id(self, header: int, *, is_standard: bool) -> int:
        """Return what becomes of a header: which protocol it is for is known when it is used, not when it is set."""
        if is_standard:
            return header & LARGEST_STANDARD_ID
        return header if header > _HEADER_BITS else self.priority << 24 | header

    @property
    def protocol_name(self) -> str:
        """The protocol as ``AT DP`` shows it."""
        name = PROTOCOLS[self.protocol]
        return f"AUTO, {name}" if self.is_automatic and self.protocol != AUTOMATIC else name

    @property
    def protocol_number(self) -> str:
        """The protocol as ``AT DPN`` shows it."""
        return f"{'A' if self.is_automatic else ''}{self.protocol:X}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Told:
    """What a command does: the settings after it, and the line that is shown."""

    settings: Settings
    line: str = OK


_SWITCHES: Final[Mapping[str, str]] = {
    "E": "echoes",
    "L": "has_line_feeds",
    "S": "has_spaces",
    "H": "shows_headers",
    "D": "shows_length",
    "R": "shows_responses",
    "CAF": "is_formatted",
    "CFC": "controls_flow",
}
_NO_MATTER: Final = re.compile(
    r"AL|NL|AT[012]|ST[0-9A-F]{2}|CTM[15]|M[01]|V[01]|CSM[01]|LP|SS|BI|FE|STPX|JE|JS|JHF[01]|JTM[15]|PP[0-9A-F]{2}OFF"
    r"|IB(10|12|15|48|96)|IIA[0-9A-F]{2}|KW[01]|SW[0-9A-F]{2}|WM([0-9A-F]{2}){1,6}|(TA|RA|SR)[0-9A-F]{2}"
)
"""Commands that are taken and change nothing: answers are there at once, other buses not; no parameter is ever on."""


def told(settings: Settings, command: str) -> Told:
    """Return what a command does; it comes in capitals, without blanks and without its ``AT``."""
    if switch := re.fullmatch(r"(E|L|S|H|D|R|CAF|CFC)([01])", command):
        is_on = switch[2] == "1"
        return Told(settings=replace(settings, **{_SWITCHES[switch[1]]: is_on}))  # type: ignore[arg-type]  # all are bool
    if _NO_MATTER.fullmatch(command):
        return Told(settings=settings)
    for pattern, handler in _COMMANDS:
        if found := pattern.fullmatch(command):
            return handler(settings, found)
    return Told(settings=settings, line=UNKNOWN)


def _reset(_settings: Settings, _found: re.Match[str]) -> Told:
    return Told(settings=Settings(), line=VERSION)


def _defaults(settings: Settings, _found: re.Match[str]) -> Told:
    """Forget everything but which protocol was found."""
    return Told(settings=Settings(protocol=settings.protocol, is_automatic=settings.is_automatic))


def _shown(text: Callable[[Settings], str]) -> Callable[[Settings, re.Match[str]], Told]:
    return lambda settings, _found: Told(settings=settings, line=text(settings))


def _protocol(settings: Settings, found: re.Match[str]) -> Told:
    """Choose a protocol; with an A before it, another one is looked for if it is the wrong one."""
    if found[1] == "A" and not found[2]:  # protocol A, not automatic
        return Told(settings=replace(settings, protocol=0xA, is_automatic=False))
    if not found[2]:
        return Told(settings=settings, line=UNKNOWN)
    number = int(found[2], 16)
    is_automatic = bool(found[1]) or number == AUTOMATIC
    return Told(settings=replace(settings, protocol=AUTOMATIC if is_automatic else number, is_automatic=is_automatic))


def _closed(settings: Settings, _found: re.Match[str]) -> Told:
    return Told(settings=replace(settings, protocol=AUTOMATIC) if settings.is_automatic else settings)


def _header(settings: Settings, found: re.Match[str]) -> Told:
    """Set the header of requests: three digits, or six; of eight the first two are the priority."""
    number = int(found[1], 16)
    priority = number >> 24 & _PRIORITY_BITS if len(found[1]) == 8 else settings.priority
    return Told(settings=replace(settings, header=number & _HEADER_BITS, priority=priority))


def _priority(settings: Settings, found: re.Match[str]) -> Told:
    return Told(settings=replace(settings, priority=int(found[1], 16) & _PRIORITY_BITS))


def _extended_address(settings: Settings, found: re.Match[str]) -> Told:
    """Put an address before every message, or none any more."""
    return Told(settings=replace(settings, extended_address=int(found[1], 16) if found[1] else None))


def _receive_address(settings: Settings, found: re.Match[str]) -> Told:
    """Show responses with this identifier only; X stands for any digit, no digits for the usual ones."""
    digits = found[1]
    if not digits:
        return Told(settings=replace(settings, receive_id=None, receive_mask=ALL_ID_BITS))
    mask = int("".join("0" if digit == "X" else "F" for digit in digits), 16)
    number = int(digits.replace("X", "0"), 16)
    return Told(settings=replace(settings, receive_id=number, receive_mask=mask | ~((1 << 4 * len(digits)) - 1)))


def _filter(settings: Settings, found: re.Match[str]) -> Told:
    number = int(found[2], 16)
    if found[1] == "F":
        return Told(settings=replace(settings, receive_id=number))
    return Told(settings=replace(settings, receive_mask=number, receive_id=settings.receive_id or 0))


def _flow_mode(settings: Settings, found: re.Match[str]) -> Told:
    mode = int(found[1])
    lacks_header = mode == 1 and settings.flow_header is None
    if lacks_header or (mode in {1, 2} and not settings.flow_data):
        return Told(settings=settings, line=UNKNOWN)
    return Told(settings=replace(settings, flow_mode=mode))


def _flow_header(settings: Settings, found: re.Match[str]) -> Told:
    return Told(settings=replace(settings, flow_header=int(found[1], 16) & ALL_ID_BITS))


def _flow_data(settings: Settings, found: re.Match[str]) -> Told:
    return Told(settings=replace(settings, flow_data=bytes.fromhex(found[1])))


_COMMANDS: Final[tuple[tuple[re.Pattern[str], Callable[[Settings, re.Match[str]], Told]], ...]] = tuple(
    (re.compile(pattern), handler)
    for pattern, handler in (
        (r"Z|WS", _reset),
        (r"D", _defaults),
        (r"I", _shown(lambda _: VERSION)),
        (r"@1", _shown(lambda _: DESCRIPTION)),
        (r"RV", _shown(lambda _: VOLTAGE)),
        (r"IGN", _shown(lambda _: "ON")),
        (r"CS", _shown(lambda _: "T:00 R:00")),
        (r"DP", _shown(lambda settings: settings.protocol_name)),
        (r"DPN", _shown(lambda settings: settings.protocol_number)),
        (r"MA", _shown(lambda _: MONITOR)),
        (r"[ST]P(A?)(00|[0-9A-C]|)", _protocol),
        (r"PC", _closed),
        (r"SH([0-9A-F]{3}|[0-9A-F]{6}|[0-9A-F]{8})", _header),
        (r"CP([0-9A-F]{2})", _priority),
        (r"CEA([0-9A-F]{2}|)", _extended_address),
        (r"(?:CRA|AR)([0-9A-FX]{3}|[0-9A-FX]{8}|)", _receive_address),
        (r"C([FM])([0-9A-F]{3}|[0-9A-F]{8})", _filter),
        (r"FCSM([012])", _flow_mode),
        (r"FCSH([0-9A-F]{3}|[0-9A-F]{6}|[0-9A-F]{8})", _flow_header),
        (r"FCSD((?:[0-9A-F]{2}){1,5})", _flow_data),
    )
)
