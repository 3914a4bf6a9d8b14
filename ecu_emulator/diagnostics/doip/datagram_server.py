"""An entity on UDP: it says who it is when it starts, and answers who asks."""

import asyncio
import random
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

from ecu_emulator.diagnostics.controller import Controller
from ecu_emulator.diagnostics.doip.datagrams import announcement, datagram_reply
from ecu_emulator.diagnostics.doip.listening import Listening
from ecu_emulator.diagnostics.table import DoipEntity

VIN = 0xF190
MOST_DELAYED = 64  # identifications that wait for their random pause


@dataclass(slots=True)
class DatagramCounts:
    """What came and went by datagrams."""

    datagrams: int = 0
    answered_datagrams: int = 0
    dropped_datagrams: int = 0  # came faster than they may be answered
    unsent_datagrams: int = 0  # the network did not take them


class DatagramServer:
    """Answers in the running event loop from ``start`` until ``close``.

    Parameters
    ----------
    entity
        Who is asked.
    controller
        Who knows the vehicle's identification number, and whether it hears anybody now.
    open_sockets
        Returns how many connections there are, now.
    """

    def __init__(self, entity: DoipEntity, controller: Controller, *, open_sockets: Callable[[], int]) -> None:
        self._entity = entity
        self._controller = controller
        self._open_sockets = open_sockets
        self._ends: list[asyncio.DatagramTransport] = []
        self._delayed: set[asyncio.TimerHandle] = set()
        self.counts = DatagramCounts()

    async def start(self, sockets: Listening) -> None:
        loop = asyncio.get_running_loop()
        for one in sockets.udp:
            end, _ = await loop.create_datagram_endpoint(lambda: _Datagrams(self), sock=one)
            self._ends.append(end)

    def close(self) -> None:
        """Say nothing any more."""
        for timer in self._delayed:
            timer.cancel()
        for end in self._ends:
            end.close()

    async def announce(self, everybody: tuple[str, int], delay_s: float = 0.0) -> None:
        """Say who one is, as often as a controller that starts does, which takes so long [s]."""
        await asyncio.sleep(delay_s + self._pause_s())
        for _ in range(self._entity.announce_count):
            self._say(announcement(self._entity, self._controller.datum(VIN), self._entity.version), everybody)
            await asyncio.sleep(self._entity.announce_interval_s)

    def take(self, data: bytes, sender: tuple[str, int]) -> None:
        """Answer one datagram, an identification after a random pause."""
        self.counts.datagrams += 1
        reply = datagram_reply(self._entity, self._controller.datum(VIN), self._open_sockets(), data)
        if reply is None or self._controller.is_asleep:
            return
        if not reply.is_identification:
            self._answer(reply.data, sender)
        elif len(self._delayed) >= MOST_DELAYED:
            self.counts.dropped_datagrams += 1
        else:
            timer: asyncio.TimerHandle

            def say() -> None:
                self._delayed.discard(timer)
                self._answer(reply.data, sender)

            timer = asyncio.get_running_loop().call_later(self._pause_s(), say)
            self._delayed.add(timer)

    def note_unsent(self) -> None:
        """Count a datagram that the network did not take."""
        self.counts.unsent_datagrams += 1

    def _answer(self, data: bytes, receiver: tuple[str, int]) -> None:
        self.counts.answered_datagrams += 1
        self._say(data, receiver)

    def _say(self, data: bytes, receiver: tuple[str, int]) -> None:
        with suppress(OSError):  # a receiver that cannot be; others are told through note_unsent
            self._ends[0].sendto(data, receiver)

    def _pause_s(self) -> float:
        return random.uniform(0.0, self._entity.announce_wait_s)  # noqa: S311 - so that not all speak at once


class _Datagrams(asyncio.DatagramProtocol):
    """Hands datagrams on."""

    def __init__(self, server: DatagramServer) -> None:
        self._server = server

    def datagram_received(self, data: bytes, sender: tuple[str, int]) -> None:
        self._server.take(data, sender)

    def error_received(self, _error: Exception) -> None:
        self._server.note_unsent()
