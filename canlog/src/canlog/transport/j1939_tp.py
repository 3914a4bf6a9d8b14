"""J1939 transport (SAE J1939-21): messages for all (BAM), and those between two (RTS, CTS, end of message)."""

from dataclasses import dataclass, field

from canlog.frames import EXTENDED_FLAG
from canlog.transport.transfers import MOST_OPEN, NS_PER_MS, Fault, Protocol, Transfer, TransferCounts, is_padding

MANAGEMENT, DATA = 0xEC, 0xEB  # PDU formats of TP.CM and TP.DT
REQUEST_TO_SEND, CLEAR_TO_SEND, END, ANNOUNCE, ABORT = 16, 17, 19, 32, 255
FOR_ALL = 0xFF
PACKET_BYTES, FRAME_BYTES = 7, 8
SHORTEST, LONGEST = 9, 1785
# Between two packets for all: senders keep to 200 ms; T1, 750 ms, is what a receiver bears. A log with holes needs the
# shorter one: else packets of the next message fill up the one before.
FOR_ALL_LIMIT_NS = 250 * NS_PER_MS
SLOWEST_GAP_NS = 200 * NS_PER_MS
USUAL_GAPS = 3  # a sender that is slower by habit may take so many of its first gaps
BETWEEN_TWO_LIMIT_NS = 1_250 * NS_PER_MS  # T2 to T4: between frames of either side
PADDING = b"\xff"
LAST_NUMBER = 255
BEGUN = -1  # in place of the last number: a message whose first frame states a length that none has
PDU2_FORMATS = 240

Key = tuple[int, int, int]  # channel, source, destination


@dataclass(slots=True)
class _Open:
    """A message of which packets are missing."""

    first_ns: int
    last_ns: int
    length: int
    packets: int
    group: int
    priority: int
    data: bytearray
    had: set[int] = field(default_factory=set)
    expected: int = 1
    frames: int = 1
    gap_ns: int = 0  # from the announcement to the first packet
    is_complete: bool = False  # but not handed out: what follows may show that it was never this message

    def holds(self, number: int, packet: bytes) -> bool:
        """Return whether a packet is there already, and the same."""
        start = (number - 1) * PACKET_BYTES
        stop = min(start + len(packet) - 1, self.length)
        return number in self.had and self.data[start:stop] == packet[1 : 1 + stop - start]

    def take(self, t_ns: int, number: int, packet: bytes) -> bool:
        """Add a packet; return whether it can be one of this message."""
        start = (number - 1) * PACKET_BYTES
        self.data[start : start + PACKET_BYTES] = packet[1:FRAME_BYTES].ljust(PACKET_BYTES, PADDING)
        self.gap_ns = self.gap_ns or t_ns - self.first_ns
        self.had.add(number)
        self.last_ns, self.expected, self.frames = t_ns, number + 1, self.frames + 1
        self.is_complete = len(self.had) == self.packets and is_padding(self.data[self.length :])
        return self.is_complete or len(self.had) < self.packets


def _group_in(data: bytes) -> int:
    """Return the group of which a frame of connection management speaks."""
    return data[5] | data[6] << 8 | data[7] << 16


def _length_in(data: bytes) -> int:
    """Return the length of which a frame of connection management speaks."""
    return data[1] | data[2] << 8


def _is_sound(data: bytes, key: Key) -> bool:
    """Return whether an announcement or a request to send is whole and states a length that there is."""
    if len(data) < FRAME_BYTES or (key[2] == FOR_ALL) != (data[0] == ANNOUNCE):
        return False
    return SHORTEST <= _length_in(data) <= LONGEST and data[3] == -(-_length_in(data) // PACKET_BYTES)


@dataclass(slots=True)
class J1939Transport:
    """The state of every connection.

    A message that is complete is handed out with the next frame that does not belong to it, or when time has passed:
    were the next packet numbered on, then its packets were those of a longer one, whose announcement is missing.
    """

    counts: TransferCounts
    _open: dict[Key, _Open] = field(default_factory=dict)
    _orphan: dict[Key, tuple[int, int]] = field(default_factory=dict)  # last number and time of what is counted

    def feed(self, t_ns: int, channel: int, can_id: int, data: bytes) -> Transfer | None:
        """Take a frame of transport; return the message that is whole by it."""
        source, destination, form = can_id & 0xFF, can_id >> 8 & 0xFF, can_id >> 16 & 0xFF
        key = (channel, source, destination)
        if not data:
            self._count_cut(t_ns, key)
            return None
        if form == DATA:
            return self._packet(t_ns, key, data)
        kind = data[0]
        if kind in {ANNOUNCE, REQUEST_TO_SEND}:
            return self._begin(t_ns, key, can_id, data)
        other = (channel, destination, source)  # of the message that this frame answers
        if kind == ABORT:
            for one in (other, key):
                if one in self._open:
                    self._give_up(one, Fault.ABORTED)
        elif len(data) < FRAME_BYTES:
            self._count_cut(t_ns, other)
        elif kind == CLEAR_TO_SEND:
            return self._clear(t_ns, other, data)
        elif kind == END:
            return self._end(t_ns, other, data)
        return None

    def due(self, t_ns: int) -> list[Transfer]:
        """Return messages that are complete and were not contradicted in time."""
        done = [key for key, one in self._open.items() if one.is_complete and t_ns - one.last_ns > BETWEEN_TWO_LIMIT_NS]
        return [self._whole(key) for key in done]

    def close(self) -> list[Transfer]:
        """Return what is complete at the end, and count what is not."""
        done = [self._whole(key) for key in [key for key, one in self._open.items() if one.is_complete]]
        for key in list(self._open):
            self._give_up(key, Fault.CUT_OFF)
        return done

    def _begin(self, t_ns: int, key: Key, can_id: int, data: bytes) -> Transfer | None:
        before = self._settled(key, Fault.INTERRUPTED)
        self._orphan.pop(key, None)
        if not _is_sound(data, key):
            self._fault(Fault.WRONG_LENGTH)
            self._remember(key, BEGUN, t_ns)
            return before
        length, packets = _length_in(data), data[3]
        if len(self._open) >= MOST_OPEN:
            self._give_up(next(iter(self._open)), Fault.TOO_MANY)
        group = _group_in(data)
        self._open[key] = _Open(t_ns, t_ns, length, packets, group, can_id >> 26 & 7, bytearray(packets * PACKET_BYTES))
        return before

    def _packet(self, t_ns: int, key: Key, data: bytes) -> Transfer | None:
        number, one = data[0], self._open.get(key)
        is_cut = one is not None and len(data) <= min(PACKET_BYTES, one.length - (number - 1) * PACKET_BYTES)
        is_for_all = key[2] == FOR_ALL
        limit_ns = self._limit_ns(key, number) if is_for_all else BETWEEN_TWO_LIMIT_NS
        if one is not None and one.is_complete and t_ns - one.last_ns <= limit_ns and number == one.packets + 1:
            one.is_complete = False  # its packets were those of a longer message without announcement
            self._give_up(key, Fault.FRAME_MISSING)
            self._orphan[key] = (number, t_ns)
            return None
        is_again = one is not None and not is_for_all and one.holds(number, data)  # as a receiver may ask for
        if one is not None and ((one.is_complete and not is_again) or t_ns - one.last_ns > limit_ns):
            before = self._settled(key, Fault.TIMEOUT)
            self._without_beginning(t_ns, key, number, limit_ns)
            return before
        if one is None:
            self._without_beginning(t_ns, key, number, limit_ns)
            return None
        if 1 <= number <= one.packets and is_cut and not is_for_all:
            return None  # its receiver asks for it again
        if is_cut or not (number == one.expected if is_for_all else 1 <= number <= one.packets):
            self._give_up(key, Fault.FRAME_MISSING)
            self._remember(key, number, t_ns)
            if number < one.expected or number > one.packets:
                self._fault(Fault.NO_BEGINNING)  # it is a packet of another message, whose announcement is missing
        elif not one.take(t_ns, number, data):
            self._give_up(key, Fault.FRAME_MISSING)  # bytes beyond the end: the packets of another message
        return None

    def _clear(self, t_ns: int, key: Key, data: bytes) -> Transfer | None:
        """Take a receiver's leave to send, or to send again."""
        one = self._open.get(key)
        is_beginning = data[2] == 1
        if one is not None and _group_in(data) == one.group and not (is_beginning and one.had):
            one.last_ns = t_ns
            one.expected = data[2] if data[1] and 1 <= data[2] <= one.packets else one.expected
            return None
        before = self._settled(key, Fault.INTERRUPTED)
        is_beginning = is_beginning and self._orphan.get(key, (0, 0))[0] != BEGUN
        if is_beginning or one is not None or self._is_nothing_known(t_ns, key):
            self._fault(Fault.NO_BEGINNING)  # a message begins of which the request is missing
            self._remember(key, max(data[2] - 1, 0) if data[1] else BEGUN, t_ns)  # none at a time: it has to wait
        return before

    def _end(self, t_ns: int, key: Key, data: bytes) -> Transfer | None:
        """Take a receiver's word that it has all of a message."""
        one = self._open.get(key)
        is_its_own = one is not None and _group_in(data) == one.group and _length_in(data) == one.length
        if one is not None and is_its_own and one.is_complete:
            self._orphan.pop(key, None)
            return self._whole(key)
        before = self._settled(key, Fault.FRAME_MISSING if is_its_own else Fault.INTERRUPTED)
        if not is_its_own and (one is not None or self._is_nothing_known(t_ns, key)):
            self._fault(Fault.NO_BEGINNING)  # of another message nothing but this is left
        self._orphan.pop(key, None)
        return before

    def _settled(self, key: Key, fault: Fault) -> Transfer | None:
        """End a message: return it if it is complete, else count why not."""
        one = self._open.get(key)
        if one is None:
            return None
        if one.is_complete:
            return self._whole(key)
        self._give_up(key, fault)
        return None

    def _limit_ns(self, key: Key, number: int) -> int:
        """Return how long a message for all may be silent before a packet; lost packets took their time."""
        one = self._open.get(key)
        gap_ns = one.gap_ns if one else SLOWEST_GAP_NS
        expected = one.expected if one else self._orphan.get(key, (number, 0))[0] + 1
        return max(FOR_ALL_LIMIT_NS, USUAL_GAPS * gap_ns) + max(number - expected, 0) * (gap_ns or SLOWEST_GAP_NS)

    def _without_beginning(self, t_ns: int, key: Key, number: int, limit_ns: int) -> None:
        """Count a message whose beginning is missing, once."""
        last, last_ns = self._orphan.get(key, (LAST_NUMBER + 1, t_ns))
        is_another = number <= last if key[2] == FOR_ALL else last > LAST_NUMBER
        if is_another or t_ns - last_ns > limit_ns:
            self._fault(Fault.NO_BEGINNING)
        self._remember(key, number, t_ns)

    def _count_cut(self, t_ns: int, key: Key) -> None:
        """Count the message of a frame of which too little is left to tell more, once."""
        one = self._open.get(key)
        if one is None and self._is_nothing_known(t_ns, key):
            self._fault(Fault.WRONG_LENGTH)
            self._remember(key, 0, t_ns)

    def _is_nothing_known(self, t_ns: int, key: Key) -> bool:
        """Return whether no message of this connection is counted that may still go on."""
        return key not in self._orphan or t_ns - self._orphan[key][1] > BETWEEN_TWO_LIMIT_NS

    def _remember(self, key: Key, number: int, t_ns: int) -> None:
        if len(self._orphan) >= MOST_OPEN and key not in self._orphan:
            del self._orphan[next(iter(self._orphan))]
        self._orphan[key] = (number, t_ns)

    def _whole(self, key: Key) -> Transfer:
        one = self._open.pop(key)
        channel, source, destination = key
        self.counts.add_whole(Protocol.J1939_TP)
        is_addressed = (one.group >> 8 & 0xFF) < PDU2_FORMATS
        specific = destination if is_addressed else one.group & 0xFF
        can_id = one.priority << 26 | (one.group & 0x3FF00) << 8 | specific << 8 | source
        return Transfer(
            protocol=Protocol.J1939_TP,
            channel=channel,
            can_id=EXTENDED_FLAG | can_id,
            destination=destination,
            first_ns=one.first_ns,
            last_ns=one.last_ns,
            frames=one.frames,
            data=bytes(one.data[: one.length]),
        )

    def _give_up(self, key: Key, fault: Fault) -> None:
        one = self._open.pop(key)
        self._orphan[key] = (one.expected - 1, one.last_ns)
        self._fault(fault)

    def _fault(self, fault: Fault) -> None:
        self.counts.add_fault(Protocol.J1939_TP, fault)
