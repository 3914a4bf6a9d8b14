"""Who else sends what only this emulator should: a second emulator on one bus makes every result of it worthless."""

import threading
from collections.abc import Callable, Sequence
from types import TracebackType
from typing import Final, Self

import can
import can.typechecking

WORTH_SAYING: Final = 10  # frames; fewer may be the last ones of an emulator that has just been stopped
POLL_S: Final = 0.1
JOIN_S: Final = 5.0
STANDARD_MASK: Final = 0x7FF
EXTENDED_MASK: Final = 0x1FFFFFFF


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
    wanted_ids, pass_on
        Identifiers of frames that somebody else on this end wants, and who is handed them, in that thread.
    """

    def __init__(
        self,
        bus: can.BusABC,
        can_ids: Sequence[int],
        on_heard: Callable[[int], None],
        *,
        wanted_ids: Sequence[int] = (),
        pass_on: Callable[[can.Message], None] = lambda _: None,
    ) -> None:
        self._bus = bus
        self._can_ids = frozenset(can_ids)
        self._on_heard = on_heard
        self._wanted_ids = tuple(wanted_ids)
        self._pass_on = pass_on
        self._is_over = threading.Event()
        self._thread = threading.Thread(target=self._listen, name="other senders", daemon=True)
        self.frame_count = 0

    def __enter__(self) -> Self:
        self._bus.set_filters([_filter(can_id) for can_id in (*sorted(self._can_ids), *self._wanted_ids)])
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
            if message is None:
                continue
            if self._is_foreign(message):
                self._note(message.arbitration_id)
            else:
                self._pass_on(message)

    def _is_foreign(self, message: can.Message) -> bool:
        is_plain = not (message.is_error_frame or message.is_extended_id)
        return is_plain and message.arbitration_id in self._can_ids

    def _note(self, can_id: int) -> None:
        self.frame_count += 1
        if self.frame_count == WORTH_SAYING:
            self._on_heard(can_id)


def _filter(can_id: int) -> can.typechecking.CanFilter:
    is_extended = can_id > STANDARD_MASK
    return {"can_id": can_id, "can_mask": EXTENDED_MASK if is_extended else STANDARD_MASK, "extended": is_extended}
