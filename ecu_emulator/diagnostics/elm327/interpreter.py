"""One ELM327: a line that somebody typed in, lines that are shown out. Pure but for what it asks the controller."""

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Final

from ecu_emulator.diagnostics.codes import NEGATIVE, Nrc
from ecu_emulator.diagnostics.elm327.settings import (
    AUTOMATIC,
    CAN_11_250,
    CAN_11_500,
    CAN_29_250,
    CAN_29_500,
    LARGEST_STANDARD_ID,
    MONITOR,
    UNKNOWN,
    Settings,
    told,
)
from ecu_emulator.diagnostics.table import Addressing, Transport

SEARCHING: Final = "SEARCHING..."
NO_DATA: Final = "NO DATA"
UNABLE: Final = "UNABLE TO CONNECT"
MOST_RAW_BYTES: Final = 8
HALF_BITRATE: Final = 250_000
_IS_ANYBODY_THERE: Final = b"\x01\x00"
_ON_CAN: Final = range(0x6, 0x10)
_ON_K_LINE: Final = range(0x3, 0x6)

Ask = Callable[[bytes, bool], bytes | None]  # a request, whether to all; the response
MOST_SINGLE_BYTES: Final = 7
_FIRST_BYTES: Final = 6
_FRAME_BYTES: Final = 8
_FIRST: Final = 0x1000
_CONSECUTIVE: Final = 0x20


def framed(payload: bytes, padding: int | None) -> list[bytes]:
    """Return the frames that carry a message; those that are not full are filled up, if anything is to be."""
    if len(payload) <= MOST_SINGLE_BYTES:
        return [_filled(bytes([len(payload)]) + payload, padding)]
    rest = payload[_FIRST_BYTES:]
    pieces = [rest[place : place + MOST_SINGLE_BYTES] for place in range(0, len(rest), MOST_SINGLE_BYTES)]
    return [
        (_FIRST | len(payload)).to_bytes(2, "big") + payload[:_FIRST_BYTES],
        *(_filled(bytes([_CONSECUTIVE | place & 0x0F]) + piece, padding) for place, piece in enumerate(pieces, 1)),
    ]


def _filled(frame: bytes, padding: int | None) -> bytes:
    return frame if padding is None else frame.ljust(_FRAME_BYTES, bytes([padding]))


def shown(frames: Sequence[bytes], can_id: int, settings: Settings) -> list[str]:
    """Return frames as lines of an adapter, as its settings want them."""
    if settings.shows_headers or not settings.is_formatted:
        return [
            line(can_id, _meant(frame) if settings.is_formatted else frame, settings, len(frame)) for frame in frames
        ]
    head = frames[0]
    if head[0] >> 4 == 0:
        return [_spaced(_meant(head)[1:], settings)]
    colon = ": " if settings.has_spaces else ":"
    pieces = [head[2:], *(frame[1:] for frame in frames[1:])]
    length = int.from_bytes(head[:2], "big") & 0xFFF
    return [f"{length:03X}"] + [
        f"{place & 0xF:X}{colon}{_spaced(piece, settings)}" for place, piece in enumerate(pieces)
    ]


def line(can_id: int, data: bytes, settings: Settings, length: int) -> str:
    """Return one frame as a line; ``length`` is that of the whole frame, if not all of it is shown."""
    if not settings.shows_headers:
        return _spaced(data, settings)
    is_standard = can_id <= LARGEST_STANDARD_ID
    header = f"{can_id:03X}" if is_standard else _spaced(can_id.to_bytes(4, "big"), settings).rstrip()
    parts = [header, *([f"{length:X}"] if settings.shows_length else [])]
    blank = " " if settings.has_spaces else ""
    return blank.join([*parts, _spaced(data, settings)])


def _meant(frame: bytes) -> bytes:
    """Return a frame without what only fills it up, as far as it says how long it is itself."""
    return frame[: 1 + frame[0]] if frame[0] >> 4 == 0 else frame


def _spaced(data: bytes, settings: Settings) -> str:
    """Return bytes as digits; each is followed by a blank, the last one too."""
    return "".join(f"{byte:02X} " for byte in data) if settings.has_spaces else data.hex().upper()


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """What an adapter does with a line."""

    lines: tuple[str, ...] = ()
    monitors: bool = False  # frames of the bus are shown from now on
    awaited: int | None = None  # a service whose response comes later


@dataclass(slots=True)
class _Parts:
    """A message of several frames that a client sends frame by frame."""

    length: int
    data: bytes


class Interpreter:
    """What one client sees of an adapter.

    Parameters
    ----------
    addressing, transport
        How the controller is reached on CAN.
    ask
        Asks it.
    bitrate
        Of the bus [bit/s]; None: the usual one.
    """

    def __init__(self, addressing: Addressing, transport: Transport, ask: Ask, bitrate: int | None = None) -> None:
        self.settings = Settings()
        self._ids = addressing
        self._transport = transport
        self._ask = ask
        self._is_standard = addressing.response_id <= LARGEST_STANDARD_ID
        slow, fast = (CAN_11_250, CAN_11_500) if self._is_standard else (CAN_29_250, CAN_29_500)
        self._protocol = slow if bitrate == HALF_BITRATE else fast
        self._last = ""
        self._parts: _Parts | None = None
        self._held: list[bytes] = []  # frames that wait for the client to let them go on

    def take(self, text: str) -> Shown:
        """Return what is shown of a line; an empty one repeats the last."""
        words = re.sub(r"\s", "", text).upper() or self._last
        self._last = words
        if not words:
            return Shown()
        if words.startswith("AT"):
            outcome = told(self.settings, words[2:])
            self.settings = outcome.settings
            return Shown(monitors=True) if outcome.line == MONITOR else Shown(lines=(outcome.line,))
        if re.fullmatch(r"[0-9A-F]{2,}", words):
            return self._requested(bytes.fromhex(words[: len(words) & ~1]))  # an odd digit: how many may answer
        return Shown(lines=(UNKNOWN,))

    def _requested(self, data: bytes) -> Shown:
        if len(data) > (MOST_SINGLE_BYTES if self.settings.is_formatted else MOST_RAW_BYTES):
            return Shown(lines=(UNKNOWN,))
        if self.settings.protocol == AUTOMATIC:
            return self._searched(data)
        if self.settings.protocol != self._protocol:
            return Shown(lines=(self._wrong_bus(),))
        return self._sent(data)

    def _searched(self, data: bytes) -> Shown:
        """Look for the vehicle's protocol, then send."""
        answer = self._sent(data)
        if answer.lines == (NO_DATA,) and self._ask(_IS_ANYBODY_THERE, True) is None:
            return Shown(lines=(SEARCHING, UNABLE))
        self.settings = replace(self.settings, protocol=self._protocol)
        return replace(answer, lines=(SEARCHING, *answer.lines))

    def _wrong_bus(self) -> str:
        """Return what is seen of a vehicle on a protocol that it does not speak."""
        if self.settings.protocol in _ON_CAN:
            return "CAN ERROR"
        return "BUS INIT: ...ERROR" if self.settings.protocol in _ON_K_LINE else NO_DATA

    def _sent(self, data: bytes) -> Shown:
        if self.settings.is_formatted:
            return self._asked(data)
        kind = data[0] >> 4
        if kind == 0:
            return self._asked(data[1 : 1 + data[0]]) if 0 < data[0] < len(data) else Shown(lines=(NO_DATA,))
        if kind == 1 and len(data) == MOST_RAW_BYTES:
            return self._begun(data)
        if kind == 2 and self._parts is not None:
            return self._continued(self._parts, data[1:])
        if kind == 3 and self._held and data[0] == 0x30:
            held, self._held = self._held, []
            return Shown(lines=tuple(shown(held, self._ids.response_id, self.settings)))
        return Shown(lines=(NO_DATA,))

    def _begun(self, data: bytes) -> Shown:
        """Take the first of several frames; the controller says how it wants the others."""
        if self._header() != self._ids.request_id:
            return Shown(lines=(NO_DATA,))
        length = int.from_bytes(data[:2], "big") & 0xFFF
        self._parts = _Parts(length=length, data=data[2:])
        flow = bytes([0x30, 0, self._transport.separation_time])
        fill = self._transport.padding
        frame = flow if fill is None else flow.ljust(MOST_RAW_BYTES, bytes([fill]))
        return Shown(lines=self._taken([frame]))

    def _continued(self, parts: _Parts, data: bytes) -> Shown:
        parts.data += data
        if len(parts.data) < parts.length:
            return Shown(lines=(NO_DATA,))
        self._parts = None
        return self._asked(parts.data[: parts.length])

    def _header(self) -> int:
        own = self.settings.request_id(is_standard=self._is_standard)
        return self._ids.functional_id if own is None else own

    def _asked(self, payload: bytes) -> Shown:
        self._held = []
        header = self._header()
        is_heard = self.settings.extended_address is None and header in {self._ids.functional_id, self._ids.request_id}
        if not payload or not is_heard:
            return Shown(lines=(NO_DATA,))
        response = self._ask(payload, header == self._ids.functional_id)
        if not self.settings.shows_responses:
            return Shown()
        if response is None:
            return Shown(lines=(NO_DATA,))
        is_pending = len(response) == 3 and response[0] == NEGATIVE and response[2] == Nrc.RESPONSE_PENDING
        return Shown(lines=self.lines(response), awaited=payload[0] if is_pending else None)

    def lines(self, response: bytes) -> tuple[str, ...]:
        """Return what is shown of a response."""
        frames = framed(response, self._transport.padding)
        if len(frames) > 1 and not self._lets_go_on():
            self._held = frames[1:]
            frames = frames[:1]
        return self._taken(frames)

    def _taken(self, frames: list[bytes]) -> tuple[str, ...]:
        if not self.settings.takes(self._ids.response_id):
            return (NO_DATA,)
        return tuple(shown(frames, self._ids.response_id, self.settings))

    def _lets_go_on(self) -> bool:
        """Return whether the adapter itself asks for the rest of a message, and the controller understands it."""
        settings = self.settings
        if not settings.controls_flow:
            return False
        if settings.flow_mode == 1 and settings.flow_id(is_standard=self._is_standard) != self._ids.request_id:
            return False
        return settings.flow_mode == 0 or (settings.flow_data[0] == 0x30 and len(settings.flow_data) >= 3)
