"""Who else sends what only this emulator should: a second emulator on one bus makes every result of it worthless."""

import threading
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Final, Self

import can

WORTH_SAYING: Final = 10  # frames; fewer may be the last ones of an emulator that has just been stopped
POLL_S: Final = 0.1
JOIN_S: Final = 5.0
STANDARD_MASK: Final = 0x7FF


class OtherSenders:
    """Counts frames on a bus that carry given identifiers and that this bus object did not send, while entered.

    Parameters
    ----------
    bus
        An open bus that does not hear itself; it is only read here, in a thread of its own, through a filter.
    can_ids
        Standard identifiers that nobody else should send.
    on_heard
        Called once, in that thread, with the identifier of a frame, as soon as it cannot be chance.
    """

    def __init__(self, bus: can.BusABC, can_ids: Sequence[int], on_heard: Callable[[int], None]) -> None:
        self._bus = bus
        self._can_ids = frozenset(can_ids)
        self._on_heard = on_heard
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._listen, name="other senders", daemon=True)
        self.frame_count = 0

    def __enter__(self) -> Self:
        self._bus.set_filters(
            [{"can_id": can_id, "can_mask": STANDARD_MASK, "extended": False} for can_id in sorted(self._can_ids)]
        )
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._is_over.set()
        self._thread.join(JOIN_S)

    def _listen(self) -> None:
        while not self._is_over.is_set():
            try:
                message = self._bus.recv(timeout=POLL_S)
            except (can.CanError, OSError, ValueError):
                self._is_over.wait(POLL_S)  # whoever sends will say what is wrong with the bus
                continue
            if message is not None and self._is_foreign(message):
                self._note(message.arbitration_id)

    def _is_foreign(self, message: can.Message) -> bool:
        is_plain = not (message.is_error_frame or message.is_extended_id)
        return is_plain and message.arbitration_id in self._can_ids

    def _note(self, can_id: int) -> None:
        self.frame_count += 1
        if self.frame_count == WORTH_SAYING:
            self._on_heard(can_id)
