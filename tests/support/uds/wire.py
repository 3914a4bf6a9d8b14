"""A controller behind ISO-TP without a bus: frames go in and come out as hexadecimal text."""

import queue
import re
import secrets
import time
from collections.abc import Callable
from dataclasses import replace
from types import TracebackType
from typing import Self

import can

from tests.support.patience import HANG_S
from tests.support.uds.full_table import full_table
from workshop.controller.controller import Controller, MemoryFile
from workshop.controller.descriptions import Value
from workshop.controller.link import DiagnosticLink
from workshop.controller.table import Addressing, Transport

REQUEST_ID, ALL_ID, RESPONSE_ID = 0x7E1, 0x7DF, 0x7E9
PARKED: dict[str, Value] = {
    "vehicle_speed_m_s": 0.0, "engine_speed_rad_s": 85.0, "sump_temperature_k": 353.15, "pedal_ratio": 0.0,
    "current_gear": 0.0, "brake_pressure_pa": 1e6, "engine_run_time_s": 60.0, "revs_possible": 1.0,
    "clearing_possible": 1.0,
}  # fmt: skip


def parked_controller(
    transport: Transport | None = None,
    addressing: Addressing | None = None,
    clock: Callable[[], float] = time.monotonic,
    store: MemoryFile | None = None,
) -> Controller:
    table = full_table()
    table = replace(table, transport=transport or table.transport, addressing=addressing or table.addressing)
    return Controller(table, values=lambda: PARKED, clock=clock, chance=secrets.token_bytes, store=store)


_IS_PENDING = re.compile("03 7f .. 78")


class Wire:
    """The frames of one link, while it is entered."""

    def __init__(
        self,
        transport: Transport | None = None,
        clock: Callable[[], float] = time.monotonic,
        store: MemoryFile | None = None,
    ) -> None:
        self._heard: queue.Queue[can.Message] = queue.Queue()
        self.controller = parked_controller(transport, clock=clock, store=store)
        self.link = DiagnosticLink(self.controller, self._heard.put)

    def __enter__(self) -> Self:
        self.link.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.link.__exit__(kind, error, trace)

    def put(self, frame: str | bytes, can_id: int = REQUEST_ID, *, is_fd: bool = False) -> None:
        data = bytes.fromhex(frame) if isinstance(frame, str) else frame
        self.link.feed(
            can.Message(arbitration_id=can_id, is_extended_id=can_id > 0x7FF, data=data, is_fd=is_fd, check=False)
        )

    def get(self) -> str:
        """Return the next frame of the controller, other than that an answer takes its time, as on a busy machine."""
        while _IS_PENDING.search(frame := self.get_any()):
            pass
        return frame

    def get_any(self) -> str:
        """Return the next frame of the controller."""
        message = self._heard.get(timeout=HANG_S)
        assert message.arbitration_id == self.controller.table.addressing.response_id
        return bytes(message.data).hex(" ")

    def get_within(self, duration_s: float) -> str:
        """Return the next frame of the controller, empty if none comes for so long."""
        try:
            return bytes(self._heard.get(timeout=duration_s).data).hex(" ")
        except queue.Empty:
            return ""
