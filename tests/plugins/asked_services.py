"""Pytest plugin: every byte that asking for signals sends, in each test marked ``asks``, counted by service.

Watched is what leaves the process: frames on any bus of python-can, lines to an ELM327 adapter, messages over IP. A
service that is not for reading fails its test. What other processes say, a test hands over with ``note_log``.
"""

import os
import socket
import sys
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import can
import pytest
from can.interfaces.socketcan import SocketcanBus
from can.interfaces.virtual import VirtualBus

from canlog.frames import join
from canlog.live.multicast import MulticastBus
from canlog.logs import read_log

if TYPE_CHECKING:
    from types import FrameType

READING: Final = frozenset({0x22, 0x01, 0x21, 0x3E})
DEFINE: Final = 0x2C  # only where the marker says that the profile allows it
GROUP_REQUEST: Final = 0xEA  # SAE J1939: PDU format of a request, no service of UDS
PRODUCT, EMULATOR = ("diag_service.", "workshop.tester."), ("ecu_emulator.", "workshop.controller.")
ADAPTERS: Final = "workshop.tester.adapters"  # says dialogues on a bus of the process, too
SETUP: Final = b"AT"  # of the adapter itself: nothing of that reaches the car
DIAGNOSTIC_MESSAGE: Final = 0x8001
TESTERS: Final = range(0x0E00, 0x1000)  # ISO 13400-2: logical addresses of testers
_NAMES: Final = {GROUP_REQUEST: "J1939"}


class SentByUs:
    """What the product sent to cars."""

    def __init__(self) -> None:
        self.services: Counter[int] = Counter()
        self.byte_count = 0
        self.odd: list[str] = []  # what is no request, in words

    def note_frame(self, message: can.Message) -> None:
        """Count a frame that is on its way to a car."""
        data, can_id = bytes(message.data), message.arbitration_id
        self.byte_count += len(data)
        if message.is_extended_id and can_id >> 16 & 0xFF == GROUP_REQUEST:
            self.services[GROUP_REQUEST] += 1
            return
        kind, short = data[0] >> 4, data[0] & 0xF
        if kind == 0:
            self.services[data[1] if short else data[2]] += 1
        elif kind == 1:
            self.services[data[2]] += 1
        elif kind > 3:
            self.odd.append(f"{can_id:X} {data.hex()}")

    def note_line(self, line: bytes) -> None:
        """Count what an adapter is told."""
        self.byte_count += len(line)
        if not line.startswith(SETUP):
            self.services[int(line[:2], 16)] += 1

    def note_over_ip(self, message: bytes) -> None:
        """Count a message of DoIP; what a node says is none of ours."""
        kind, sender = int.from_bytes(message[2:4]), int.from_bytes(message[8:10])
        if message[:1] != b"\x02" or kind != DIAGNOSTIC_MESSAGE or sender not in TESTERS:
            return
        self.byte_count += len(message)
        self.services[message[12]] += 1

    def note_log(self, path: Path, request_id: int = 0x7E1) -> None:
        """Count what another process sent, from a recording of the bus."""
        frames = join(list(read_log(path)))
        requests = frames[frames.can_id == request_id]
        for data, length in zip(requests.data, requests.length.tolist(), strict=True):
            self.note_frame(can.Message(arbitration_id=request_id, data=data[:length].tobytes(), is_extended_id=False))

    def check(self, *, may_define: bool) -> None:
        """Fail if anything else was sent than may be."""
        allowed = READING | {GROUP_REQUEST} | ({DEFINE} if may_define else set())
        assert set(self.services) <= allowed, f"sent: {text_of(self.services)}"
        assert not self.odd, self.odd


def text_of(services: Counter[int]) -> str:
    """Return counts by service for people."""
    return ", ".join(f"{_NAMES.get(one, f'{one:02X}')} {count}" for one, count in sorted(services.items())) or "nothing"


def _sending_module() -> str:
    """Return the module of the product that sends just now; empty: somebody else does."""
    frame: FrameType | None = sys._getframe(2)  # of who sends
    while frame is not None:
        name = str(frame.f_globals.get("__name__", ""))
        if name.startswith(PRODUCT):
            return name
        frame = None if name.startswith(EMULATOR) else frame.f_back
    return ""


@pytest.fixture(autouse=True)
def sent_by_us(request: pytest.FixtureRequest) -> Iterator[SentByUs]:
    """Yield what a test that asks has sent until now; when it ends, that is looked at."""
    mark, sent = request.node.get_closest_marker("asks"), SentByUs()
    if mark is None:
        yield sent
        return
    with pytest.MonkeyPatch.context() as patch:
        for kind in (VirtualBus, SocketcanBus, MulticastBus):
            patch.setattr(kind, "send", _watched(kind.send, sent.note_frame, lambda name: name != ADAPTERS))
        patch.setattr(os, "write", _watched(os.write, sent.note_line, lambda name: name == ADAPTERS))
        patch.setattr(socket.socket, "send", _watched(socket.socket.send, sent.note_over_ip, bool))
        yield sent
    sent.check(may_define=mark.kwargs.get("may_define", False))


def _watched(
    send: Callable[..., Any], note: Callable[[Any], None], is_ours: Callable[[str], bool]
) -> Callable[..., Any]:
    """Return what sends as before and notes what the product sends by it."""

    def watched(to: Any, what: Any, *others: Any, **more: Any) -> Any:  # noqa: ANN401 - of several signatures
        if (name := _sending_module()) and is_ours(name):
            note(what)
        return send(to, what, *others, **more)

    return watched
