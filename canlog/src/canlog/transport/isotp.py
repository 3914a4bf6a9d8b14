"""ISO-TP (ISO 15765-2) as somebody sees it who listens to both sides: requests, answers and flow control."""

from dataclasses import dataclass, field

from canlog.transport.transfers import MOST_OPEN, NS_PER_MS, Fault, Protocol, Transfer, TransferCounts

SINGLE, FIRST, CONSECUTIVE, FLOW_CONTROL = range(4)
CONTINUE, WAIT, OVERFLOW = range(3)  # what a flow control says
LIMIT_NS = 1_000 * NS_PER_MS  # N_Cr and N_Bs: longest silence between two frames
CLASSIC_BYTES = 8
SEQUENCE = 16
SHORTEST_LONG = 8  # a message of fewer bytes fits into a single frame, of CAN FD or not
LONGEST = 1 << 20  # 32 bits could say more; no controller has it
USUAL_FRAMES = 2  # by so many of its longest gaps a sender may be late
TESTER_PRESENT = 0x3E
MOST_FRAMES = LONGEST // 6
LONGEST_CLASSIC = 0xFFF
UNKNOWN = 1 << 62  # stays above all of them

Key = tuple[int, int]  # channel, identifier with flags


@dataclass(slots=True)
class _Open:
    """A message of which frames are missing."""

    first_ns: int
    last_ns: int
    length: int
    data: bytearray
    frames: int = 1
    sequence: int = 1  # of the frame that has to come
    is_allowed: bool = False  # a flow control came
    block: int = 0  # frames that it allows at a time; 0: all
    allowed: int = 0  # of them that have not come yet
    frame_bytes: int = CLASSIC_BYTES  # of each frame but the last

    @property
    def left(self) -> int:
        """How many frames have to come yet."""
        return -(-(self.length - len(self.data)) // (self.frame_bytes - 1))


@dataclass(slots=True)
class _Orphan:
    """What is known of a message that is counted as incomplete already."""

    last: int  # number of its last frame
    last_ns: int
    left: int = UNKNOWN  # frames that have to come yet
    block: int = 0  # frames that flow control allows at a time; 0: not known
    allowed: int = 0  # that have not come yet
    is_announced: bool = False  # the last that was seen of it is flow control
    is_waiting: bool = False  # that says: wait
    missed: int = 0  # frames that were allowed and did not come before it spoke again, of this message or of another
    gap_ns: int = 0  # the longest to a frame
    is_late: bool = False  # it spoke again later than this sender would need for what was missed

    def goes_on_with(self, t_ns: int, sequence: int) -> bool:
        """Return whether a frame is one of this message."""
        step = (sequence - self.last) % SEQUENCE
        if t_ns - self.last_ns > LIMIT_NS:
            return False
        if self.left <= MOST_FRAMES:
            return 1 <= step <= min(self.left, SEQUENCE // 2)
        # Of another, its first frame is lost, those below this number, and flow control or the end of this message.
        return 1 <= step <= 3 + (sequence - 1) % SEQUENCE

    def go_on_with(self, t_ns: int, sequence: int) -> None:
        """Take a frame of this message."""
        step = (sequence - self.last - 1) % SEQUENCE + 1
        self.gap_ns = max(self.gap_ns, (t_ns - self.last_ns) // step)
        self.last, self.last_ns, self.left = sequence, t_ns, self.left - step
        self.is_announced, self.is_waiting, self.missed = False, False, 0
        self.allowed -= step
        if self.allowed < 0:  # flow control is lost
            self.allowed = self.allowed % self.block if self.block else 0

    def ends_before(self, t_ns: int, block: int) -> bool:
        """Return whether flow control that allows so many frames cannot be one for this message."""
        if t_ns - self.last_ns > LIMIT_NS or self.left <= 0:
            return True
        return not self.is_waiting and (block == 0 or (self.is_announced and self.left <= self.allowed))

    def control(self, t_ns: int, status: int, block: int) -> None:
        """Take flow control for this message, or for one that cannot be told from it yet."""
        if status != WAIT:
            self.missed = self.allowed if self.left > MOST_FRAMES and not self.is_waiting else 0
            self.is_late = t_ns - self.last_ns > (self.missed + USUAL_FRAMES) * self.gap_ns
            self.block, self.allowed = block, self.allowed + block
        self.last_ns, self.is_announced, self.is_waiting = t_ns, True, status == WAIT


@dataclass(slots=True)
class IsoTp:
    """The state of every conversation; ``peer_of`` says to whose identifier an identifier's frames are the other side.

    Flow control or a consecutive frame that nothing precedes speaks of a message whose beginning is missing: counted
    once, until one begins, or the numbers begin again.
    """

    counts: TransferCounts
    _open: dict[Key, _Open] = field(default_factory=dict)
    _orphan: dict[Key, _Orphan] = field(default_factory=dict)

    def feed(self, t_ns: int, key: Key, peer: Key | None, data: bytes) -> Transfer | None:
        """Take a frame of a sender, whose other side has the identifier ``peer``; return the message it completes."""
        kind = data[0] >> 4 if data else -1
        if kind == FLOW_CONTROL:
            self._control(t_ns, key, peer, data)
            return None
        if kind == SINGLE:
            return self._single(t_ns, key, peer, data)
        if kind == FIRST:
            self._begin(t_ns, key, peer, data)
        elif kind == CONSECUTIVE:
            return self._continue(t_ns, key, peer, data)
        return None

    def close(self) -> None:
        """Count what is not complete at the end."""
        for key in list(self._open):
            self._give_up(key, Fault.CUT_OFF)
        for key in list(self._orphan):
            self._forget(key)

    def _single(self, t_ns: int, key: Key, peer: Key | None, data: bytes) -> Transfer | None:
        length, start = data[0] & 0x0F, 1
        if length == 0 and len(data) > CLASSIC_BYTES:
            length, start = data[1], 2
        if length == 0 or start + length > len(data):
            self._fault(Fault.WRONG_LENGTH)
            return None
        self._leave(key, Fault.INTERRUPTED)
        if peer is not None and data[start] != TESTER_PRESENT:
            self._leave(peer, Fault.INTERRUPTED)  # whoever asks again waits for nothing any more
        return self._whole(key, t_ns, t_ns, 1, data[start : start + length])

    def _begin(self, t_ns: int, key: Key, peer: Key | None, data: bytes) -> None:
        self._leave(key, Fault.INTERRUPTED)
        if peer is not None:
            self._leave(peer, Fault.INTERRUPTED)
        length, start = (data[0] & 0x0F) << 8 | int.from_bytes(data[1:2]), 2
        if length == 0:
            length, start = int.from_bytes(data[2:6]), 6
        if len(data) < CLASSIC_BYTES or not max(SHORTEST_LONG, len(data) - start + 1) <= length <= LONGEST:
            self._count_orphan(t_ns, key, 0, fault=Fault.WRONG_LENGTH).is_waiting = True  # for flow control
            return
        if len(self._open) >= MOST_OPEN:
            self._give_up(next(iter(self._open)), Fault.TOO_MANY)
        self._open[key] = _Open(
            first_ns=t_ns, last_ns=t_ns, length=length, data=bytearray(data[start:]), frame_bytes=len(data)
        )

    def _control(self, t_ns: int, key: Key, peer: Key | None, data: bytes) -> None:
        """Take what a receiver says to the sender of a message."""
        if peer is None:
            return
        self._leave(key, Fault.INTERRUPTED)  # who receives has ended what it sent
        one = self._open.get(peer)
        status, block = data[0] & 0x0F, data[1] if len(data) > 1 else 0
        if one is None:
            self._control_orphan(t_ns, peer, status, block)
        elif status == OVERFLOW:
            self._give_up(peer, Fault.ABORTED)
        elif status == CONTINUE and one.is_allowed and (one.allowed or not one.block):
            self._give_up(peer, Fault.INTERRUPTED)  # it is not its turn: another message has begun, or frames are lost
            if one.block == 0 or one.left <= one.allowed:
                self._count_orphan(t_ns, peer, 0)
            self._orphan[peer].control(t_ns, status, block)
        else:
            one.last_ns = t_ns
            if status == CONTINUE:
                one.is_allowed, one.block, one.allowed = True, block, block

    def _control_orphan(self, t_ns: int, peer: Key, status: int, block: int) -> None:
        """Take flow control for a message whose beginning is missing, or that is counted as incomplete already."""
        orphan = self._orphan.get(peer)
        if orphan is not None and orphan.missed:
            orphan = self._count_orphan(orphan.last_ns, peer, 0, orphan.block)  # nothing came: it was another one
        if orphan is None or orphan.ends_before(t_ns, block):
            orphan = self._count_orphan(t_ns, peer, 0)
        orphan.control(t_ns, status, block)

    def _continue(self, t_ns: int, key: Key, peer: Key | None, data: bytes) -> Transfer | None:
        one, sequence = self._open.get(key), data[0] & 0x0F
        if one is not None and t_ns - one.last_ns > LIMIT_NS:
            self._give_up(key, Fault.TIMEOUT)
            one = None
        if one is None:
            self._without_beginning(t_ns, key, peer, sequence)
            return None
        if sequence != one.sequence or len(data) < min(one.frame_bytes, one.length - len(one.data) + 1):
            self._give_up(key, Fault.FRAME_MISSING)
            self._orphan[key].go_on_with(t_ns, sequence)
            return None
        one.data += data[1:]
        one.frames, one.last_ns, one.sequence = one.frames + 1, t_ns, (sequence + 1) % SEQUENCE
        one.allowed = (one.allowed - 1) % one.block if one.block else 0
        if len(one.data) < one.length:
            return None
        del self._open[key]
        return self._whole(key, one.first_ns, t_ns, one.frames, bytes(one.data[: one.length]))

    def _without_beginning(self, t_ns: int, key: Key, peer: Key | None, sequence: int) -> None:
        """Count a message whose beginning is missing, once."""
        orphan = self._orphan.get(key)
        if orphan is not None and orphan.goes_on_with(t_ns, sequence):
            orphan.go_on_with(t_ns, sequence)
            return
        if orphan is not None and orphan.missed and t_ns - orphan.last_ns <= LIMIT_NS:
            orphan = self._count_orphan(t_ns, key, 0, orphan.block)  # the one of which flow control spoke
            orphan.go_on_with(t_ns, sequence)
        else:
            self._forget(key)
            self._count_orphan(t_ns, key, sequence)
        if peer is not None:
            self._leave(peer, Fault.INTERRUPTED)  # who begins to send has received what the other side sent

    def _count_orphan(
        self, t_ns: int, key: Key, last: int, block: int = 0, fault: Fault = Fault.NO_BEGINNING
    ) -> _Orphan:
        """Count a message of which this is the first that is left; ``block`` frames are allowed."""
        self._fault(fault)
        if len(self._orphan) >= MOST_OPEN and key not in self._orphan:
            self._forget(next(iter(self._orphan)))
        orphan = self._orphan[key] = _Orphan(last, t_ns, block=block, allowed=block)
        return orphan

    def _forget(self, key: Key) -> None:
        """Expect no more of a message that is counted; flow control of which nobody knew the message was another's."""
        orphan = self._orphan.pop(key, None)
        if orphan is not None and orphan.missed and orphan.is_late:
            self._fault(Fault.NO_BEGINNING)

    def _whole(self, key: Key, first_ns: int, last_ns: int, frames: int, data: bytes) -> Transfer:
        self.counts.add_whole(Protocol.ISO_TP)
        channel, can_id = key
        return Transfer(
            protocol=Protocol.ISO_TP,
            channel=channel,
            can_id=can_id,
            first_ns=first_ns,
            last_ns=last_ns,
            frames=frames,
            data=data,
        )

    def _leave(self, key: Key, fault: Fault) -> None:
        """Let another message of a sender begin."""
        if key in self._open:
            self._give_up(key, fault)
        self._forget(key)

    def _give_up(self, key: Key, fault: Fault) -> None:
        one = self._open.pop(key)
        last = (one.sequence - 1) % SEQUENCE
        self._orphan[key] = _Orphan(last, one.last_ns, one.left, one.block, one.allowed)
        self._fault(fault)

    def _fault(self, fault: Fault) -> None:
        self.counts.add_fault(Protocol.ISO_TP, fault)


def segments(payload: bytes) -> list[bytes]:
    """Return the frames of eight bytes that carry a message; flow control comes after the first of several."""
    if len(payload) < CLASSIC_BYTES:
        return [bytes([len(payload)]) + payload]
    if len(payload) > LONGEST_CLASSIC:
        raise ValueError(f"a message of {len(payload)} bytes is too long")
    first = bytes([FIRST << 4 | len(payload) >> 8, len(payload) & 0xFF]) + payload[:6]
    rest = [payload[at : at + 7] for at in range(6, len(payload), 7)]
    return [first, *(bytes([CONSECUTIVE << 4 | number % SEQUENCE]) + one for number, one in enumerate(rest, 1))]
