"""A dialogue with the controller, the same each time, as the frames of a bus: what other programs are given to read."""

import queue
import time
from dataclasses import dataclass, field

import can

from ecu_emulator.diagnostics.controller import Controller
from ecu_emulator.diagnostics.link import DiagnosticLink
from ecu_emulator.diagnostics.memory import TestResult
from ecu_emulator.diagnostics.table_file import shipped_table
from tests.support.patience import HANG_S
from tests.support.uds.wire import PARKED, REQUEST_ID, RESPONSE_ID

SEED = bytes(range(1, 17))
SLIPS = 0x081107
REVS = 0x0301
ROUTINE = 0x31
PENDING = 0x78
PADDING = b"\xcc"
REQUESTS = (
    "3e 00",
    "10 03",
    "22 f1 90",
    "22 01 05 02 06",
    "19 02 0f",
    "19 04 08 11 07 01",
    "14 ff ff ff",
    "2e f1 98 43 4c 55 54 43 48 53 48 4f 50",
    "27 01",
    "27 02 5b a7 c0 38",
    "2e f1 98 43 4c 55 54 43 48 53 48 4f 50",
    "2f 02 06 03 78",
    "2f 02 06 00",
    "31 01 03 01 01 01",
    "85 02",
    "28 03 01",
    "11 01",
)
"""What a workshop asks; once something is refused, once an answer takes its time."""

Frame = tuple[int, bytes]


@dataclass
class Dialogue:
    """Frames as they went over the bus, and the messages that they carried, each with its identifier."""

    frames: list[Frame] = field(default_factory=list)
    messages: list[Frame] = field(default_factory=list)

    @property
    def log(self) -> str:
        """The frames as candump writes them, a millisecond each."""
        return "".join(
            f"(1767225600.{number * 1000:06d}) can0 {can_id:03X}#{data.hex().upper()}\n"
            for number, (can_id, data) in enumerate(self.frames)
        )


@dataclass
class Received:
    """A message of the controller, and the frames that it took, flow control among them."""

    frames: list[Frame]
    content: bytes


def is_pending(received: Received) -> bool:
    """Return whether a message says that another one follows."""
    return received.content[:1] == b"\x7f" and received.content[2] == PENDING


class Desk:
    """A tester at the controller's link, who writes down what goes back and forth."""

    def __init__(self) -> None:
        self.told = Dialogue()
        self._heard: queue.Queue[can.Message] = queue.Queue()
        self.controller = Controller(
            shipped_table(), values=lambda: PARKED, clock=time.monotonic, chance=lambda count: SEED[:count]
        )
        self.link = DiagnosticLink(self.controller, self._heard.put)

    def ask(self, request: bytes) -> None:
        """Ask, and take the final response; that one takes its time is written down once, of a routine only."""
        self._send(request)
        is_routine = request[0] == ROUTINE
        if is_routine:
            self._write_down(self._receive())
            self.controller.finish(REVS)
        while is_pending(message := self._receive()):
            pass  # the machine is busy
        self._write_down(message)

    def _write_down(self, received: Received) -> None:
        self.told.frames += received.frames
        self.told.messages.append((RESPONSE_ID, received.content))

    def _frame(self, data: bytes) -> Frame:
        """Put a frame on the bus and return it."""
        frame = data.ljust(8, PADDING)
        self.link.feed(can.Message(arbitration_id=REQUEST_ID, is_extended_id=False, data=frame))
        return REQUEST_ID, frame

    def _get(self) -> Frame:
        message = self._heard.get(timeout=HANG_S)
        return message.arbitration_id, bytes(message.data)

    def _send(self, request: bytes) -> None:
        self.told.messages.append((REQUEST_ID, request))
        if len(request) < 8:
            self.told.frames.append(self._frame(bytes([len(request)]) + request))
            return
        self.told.frames += [self._frame(bytes([0x10, len(request)]) + request[:6]), self._get()]
        assert self.told.frames[-1][1][0] == 0x30
        for number, place in enumerate(range(6, len(request), 7), start=1):
            self.told.frames.append(self._frame(bytes([0x20 | number % 16]) + request[place : place + 7]))

    def _receive(self) -> Received:
        frames = [self._get()]
        data = frames[0][1]
        size, content = data[0], data[1:]
        if data[0] >> 4 == 1:
            size, content = (data[0] & 0x0F) << 8 | data[1], data[2:]
            frames.append(self._frame(b"\x30\x00\x00"))
            while len(content) < size:
                frames.append(self._get())
                content += frames[-1][1][1:]
        return Received(frames=frames, content=content[:size])


def held_dialogue() -> Dialogue:
    """Let the dialogue take place."""
    desk = Desk()
    for _ in range(20):
        desk.controller.report(SLIPS, TestResult.FAILED)
    with desk.link:
        for request in REQUESTS:
            desk.ask(bytes.fromhex(request))
    return desk.told
