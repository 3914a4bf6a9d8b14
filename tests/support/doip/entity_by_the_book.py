"""What ISO 13400-2 has one connection told, from its prose: a whole stream in, all answers out, no state machine."""

FIRST_TESTER, LAST_TESTER = 0x0E00, 0x0FFF
OWN, ALL = 0x1011, 0xE400
LONGEST = 65536
LENGTHS = {0x0005: (7, 11), 0x0007: (0,), 0x0008: (2,)}  # what a tester may send over TCP, with its lengths
NEVER_REFUSED = (0x0000, 0x0004, 0x0006, 0x4002, 0x4004, 0x8002, 0x8003)  # answers

Told = list[tuple[int, bytes]]


class Book:
    """One connection."""

    def __init__(self) -> None:
        self.told: Told = []
        self.requests = 0
        self.is_over = False
        self._tester: int | None = None

    def read(self, stream: bytes) -> None:
        """Answer a whole stream."""
        while len(stream) >= 8 and not self.is_over:
            kind, length = int.from_bytes(stream[2:4], "big"), int.from_bytes(stream[4:8], "big")
            is_version = stream[0] in (2, 3) and stream[0] + stream[1] == 255
            refusal = _refusal(kind, length) if is_version else 0
            if refusal is not None:
                self.told.append((0x0000, bytes([refusal])))
                self.is_over = refusal in (0, 4)
            elif kind not in NEVER_REFUSED:
                if len(stream) < 8 + length:
                    return
                self._take(kind, stream[8 : 8 + length])
            stream = stream[8 + length :]

    def _take(self, kind: int, payload: bytes) -> None:
        source, target = int.from_bytes(payload[:2], "big"), payload[2:4]
        if kind == 0x0007:
            self.told.append((0x0008, OWN.to_bytes(2, "big")))
        elif kind == 0x0005:
            code = _activation(source, payload[2], self._tester)
            self.told.append((0x0006, payload[:2] + OWN.to_bytes(2, "big") + bytes([code])))
            self._tester, self.is_over = source, code != 0x10
        elif kind == 0x8001:
            code = _diagnostic(source, int.from_bytes(target, "big"), len(payload) - 4, self._tester)
            self.told.append((0x8003 if code else 0x8002, target + payload[:2] + bytes([code])))
            self.requests += not code
            self.is_over = code == 0x02


def _refusal(kind: int, length: int) -> int | None:
    if kind not in (*LENGTHS, *NEVER_REFUSED, 0x8001):
        return 1
    if length > LONGEST:
        return 2
    if kind == 0x8001:
        return None if length >= 5 else 4
    return 4 if kind in LENGTHS and length not in LENGTHS[kind] else None


def _activation(source: int, kind: int, tester: int | None) -> int:
    if not FIRST_TESTER <= source <= LAST_TESTER:
        return 0x00
    if kind not in (0, 1):
        return 0x06
    return 0x02 if tester not in (None, source) else 0x10


def _diagnostic(source: int, target: int, data_bytes: int, tester: int | None) -> int:
    if source != tester:
        return 0x02
    if target not in (OWN, ALL):
        return 0x03
    return 0x04 if data_bytes > 4095 else 0x00
