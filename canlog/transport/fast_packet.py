"""NMEA 2000 fast packets: up to 223 bytes in frames that carry a number of the message and one of the frame."""

from dataclasses import dataclass, field

from canlog.transport.transfers import MOST_OPEN, NS_PER_MS, Fault, Protocol, Transfer, TransferCounts, is_padding

FRAME_BYTES = 8
FIRST_BYTES, NEXT_BYTES = 6, 7
LONGEST = FIRST_BYTES + 31 * NEXT_BYTES
LIMIT_NS = 750 * NS_PER_MS
FRAME_MASK = 0x1F

Key = tuple[int, int]  # channel, identifier with flags


@dataclass(slots=True)
class _Open:
    first_ns: int
    last_ns: int
    length: int
    sequence: int
    data: bytearray
    frames: int = 1


@dataclass(slots=True)
class FastPackets:
    """The state of every sender's messages."""

    counts: TransferCounts
    _open: dict[Key, _Open] = field(default_factory=dict)
    _orphan: dict[Key, tuple[int, int, int]] = field(default_factory=dict)  # sequence, number and time of such frames

    def feed(self, t_ns: int, key: Key, data: bytes) -> Transfer | None:
        """Take a frame; return the message that it completes."""
        if not data:
            self._fault(Fault.WRONG_LENGTH)
            return None
        sequence, number = data[0] >> 5, data[0] & FRAME_MASK
        if number == 0:
            return self._begin(t_ns, key, sequence, data)
        one = self._open.get(key)
        if one is not None and t_ns - one.last_ns > LIMIT_NS:
            self._give_up(key, Fault.TIMEOUT)
            one = None
        if one is not None and (sequence != one.sequence or number != one.frames):
            is_another = sequence != one.sequence
            self._give_up(key, Fault.INTERRUPTED if is_another else Fault.FRAME_MISSING)
            if not is_another:
                self._remember(key, sequence, number, t_ns)
                return None
            one = None
        if one is None:
            last = self._orphan.get(key)
            if last is None or last[0] != sequence or number <= last[1] or t_ns - last[2] > LIMIT_NS:
                self._fault(Fault.NO_BEGINNING)
            self._remember(key, sequence, number, t_ns)
            return None
        one.data += data[1:FRAME_BYTES]
        one.frames, one.last_ns = one.frames + 1, t_ns
        if len(one.data) < one.length and len(data) < FRAME_BYTES:
            self._give_up(key, Fault.FRAME_MISSING)  # only the last frame needs no padding
            return None
        return self._whole(key, one) if len(one.data) >= one.length else None

    def close(self) -> None:
        """Count what is not complete at the end."""
        for key in list(self._open):
            self._give_up(key, Fault.CUT_OFF)

    def _begin(self, t_ns: int, key: Key, sequence: int, data: bytes) -> Transfer | None:
        if key in self._open:
            self._give_up(key, Fault.INTERRUPTED)
        self._orphan.pop(key, None)
        if len(data) < 2 or not 0 < data[1] <= LONGEST or len(data) < min(FRAME_BYTES, 2 + data[1]):
            self._fault(Fault.WRONG_LENGTH)
            self._remember(key, sequence, 0, t_ns)
            return None
        if len(self._open) >= MOST_OPEN:
            self._give_up(next(iter(self._open)), Fault.TOO_MANY)
        one = _Open(t_ns, t_ns, data[1], sequence, bytearray(data[2:FRAME_BYTES]))
        self._open[key] = one
        return self._whole(key, one) if len(one.data) >= one.length else None

    def _remember(self, key: Key, sequence: int, number: int, t_ns: int) -> None:
        if len(self._orphan) >= MOST_OPEN and key not in self._orphan:
            del self._orphan[next(iter(self._orphan))]
        self._orphan[key] = (sequence, number, t_ns)

    def _whole(self, key: Key, one: _Open) -> Transfer | None:
        if not is_padding(one.data[one.length :]):
            self._give_up(key, Fault.FRAME_MISSING)  # bytes beyond the end: frames of another message
            return None
        del self._open[key]
        self.counts.add_whole(Protocol.FAST_PACKET)
        channel, can_id = key
        return Transfer(
            protocol=Protocol.FAST_PACKET,
            channel=channel,
            can_id=can_id,
            first_ns=one.first_ns,
            last_ns=one.last_ns,
            frames=one.frames,
            data=bytes(one.data[: one.length]),
        )

    def _give_up(self, key: Key, fault: Fault) -> None:
        one = self._open.pop(key)
        self._remember(key, one.sequence, one.frames - 1, one.last_ns)
        self._fault(fault)

    def _fault(self, fault: Fault) -> None:
        self.counts.add_fault(Protocol.FAST_PACKET, fault)
