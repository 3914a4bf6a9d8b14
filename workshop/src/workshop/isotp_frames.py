"""ISO 15765-2 for both ends: addresses, and the frames that the standard ignores or reads in another way.

The transport library breaks off a message in progress at an unknown frame; the standard ignores that frame.
"""

from collections.abc import Callable
from enum import IntEnum
from typing import Any, Final

import isotp
from isotp.tools import Timer

LARGEST_STANDARD_ID: Final = 0x7FF
SHORT: Final = 8  # bytes of a classic frame
LONGEST_SHORT_LENGTH: Final = 0xFFF  # of a message whose length has 12 bits
LONGEST_PAUSE: Final = 0x7F  # 127 ms: what a reserved separation time means
ABORT: Final = 0x32  # flow control: overflow
NS_PER_S: Final = 1e9


class FrameType(IntEnum):
    """The upper half of the first byte."""

    SINGLE = 0
    FIRST = 1
    CONSECUTIVE = 2
    FLOW_CONTROL = 3


class ClockTimer(Timer):
    """A timer of the transport library that goes by a given clock."""

    def __init__(self, now_s: Callable[[], float], timeout_s: float) -> None:
        super().__init__(timeout_s)
        self._now_s = now_s

    def start(self, timeout: float | None = None) -> None:
        super().start(timeout)
        self.start_time = round(self._now_s() * NS_PER_S)

    def elapsed_ns(self) -> int:
        return 0 if self.start_time is None else round(self._now_s() * NS_PER_S) - self.start_time


class TransportLayer(isotp.TransportLayerLogic):
    """The transport library's logic, whose pauses and timeouts go by a given clock [s], such as virtual time."""

    def __init__(self, now_s: Callable[[], float], **settings: Any) -> None:  # noqa: ANN401 - the library's
        self._now_s = now_s
        super().__init__(**settings)
        self.timer_tx_stmin = ClockTimer(now_s, 0.0)

    def _start_rx_fc_timer(self) -> None:
        self.timer_rx_fc = self._started(self.params.rx_flowcontrol_timeout)

    def _start_rx_cf_timer(self) -> None:
        self.timer_rx_cf = self._started(self.params.rx_consecutive_frame_timeout)

    def _started(self, timeout_ms: float) -> ClockTimer:
        timer = ClockTimer(self._now_s, timeout_ms / 1e3)
        timer.start()
        return timer


def isotp_address(sent_id: int, heard_id: int, own_byte: int, other_byte: int | None) -> isotp.Address:
    """Return the address of one end; with extended addressing the first byte of a frame names the receiver."""
    bits = 29 if sent_id > LARGEST_STANDARD_ID else 11
    if other_byte is None:
        return isotp.Address(isotp.AddressingMode[f"Normal_{bits}bits"], txid=sent_id, rxid=heard_id)
    mode = isotp.AddressingMode[f"Extended_{bits}bits"]
    return isotp.Address(mode, txid=sent_id, rxid=heard_id, source_address=own_byte, target_address=other_byte)


def usable(data: bytes, prefix_bytes: int, missing_bytes: int) -> bytes | None:
    """Return the frame for the transport layer, None if the standard ignores it.

    Parameters
    ----------
    data
        All bytes of the frame.
    prefix_bytes
        1 with extended or mixed addressing, whose first byte is an address, else 0.
    missing_bytes
        Bytes that the message in progress still lacks.
    """
    body = data[prefix_bytes:]
    if not body or body[0] >> 4 not in set(FrameType):
        return None
    match FrameType(body[0] >> 4):
        case FrameType.SINGLE:
            return data if single_payload(data, prefix_bytes) is not None else None
        case FrameType.FIRST:
            return data if _is_first(data, prefix_bytes) else None
        case FrameType.CONSECUTIVE:
            is_whole = len(data) >= SHORT or len(body) - 1 >= missing_bytes
            return data if is_whole and len(body) > 1 else None
        case FrameType.FLOW_CONTROL:
            return _flow_control(data, prefix_bytes)


def single_payload(data: bytes, prefix_bytes: int) -> bytes | None:
    """Return the message in a single frame, None if the frame is invalid."""
    body = data[prefix_bytes:]
    if len(body) < 2 or body[0] >> 4 != FrameType.SINGLE:
        return None
    if len(data) <= SHORT:
        length, start, least = body[0], 1, 1
    else:
        if body[0]:
            return None
        length, start, least = body[1], 2, SHORT - prefix_bytes
    return body[start : start + length] if least <= length <= len(body) - start else None


def _is_first(data: bytes, prefix_bytes: int) -> bool:
    """Return whether a first frame is full and its message too long for a single one."""
    body = data[prefix_bytes:]
    if len(data) < SHORT:
        return False
    length = (body[0] & 0x0F) << 8 | body[1]
    if length:
        least = SHORT if len(data) == SHORT else len(data) - 1
        return length >= least - prefix_bytes
    return int.from_bytes(body[2:6], "big") > LONGEST_SHORT_LENGTH


def _flow_control(data: bytes, prefix_bytes: int) -> bytes | None:
    """Return flow control with an unknown status as an abort, with a reserved separation time as the longest."""
    prefix, body = data[:prefix_bytes], data[prefix_bytes:]
    if len(body) < 3:
        return None
    if body[0] & 0x0F > 2:
        return prefix + bytes([ABORT]) + body[1:]
    is_reserved = not (body[2] <= LONGEST_PAUSE or 0xF1 <= body[2] <= 0xF9)
    return prefix + body[:2] + bytes([LONGEST_PAUSE]) + body[3:] if is_reserved else data
