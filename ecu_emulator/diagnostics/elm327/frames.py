"""Frames of ISO-TP and how an ELM327 shows them. Pure: the link on the bus has a transport layer of its own."""

from collections.abc import Sequence
from typing import Final

from ecu_emulator.diagnostics.elm327.settings import LARGEST_STANDARD_ID, Settings

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
