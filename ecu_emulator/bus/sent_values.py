"""What the controllers of the vehicle say at this moment: the frames that were last on the bus, in SI.

Decoded when somebody asks, not when they are sent: noise, sensor faults and lost values are in them as on the bus. What
others say is believed while it is fresh and its checksum fits; what this controller senses itself, it knows.
"""

from collections.abc import Callable, Collection, Iterator, Mapping
from copy import copy
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import can
import numpy as np
from cantools.database.can import Database, Message
from cantools.database.can.signal import Signal

from canlog.e2e import profile1
from canlog.e2e.message_contract import message_contracts
from ecu_emulator.bus.frames import SIGNAL_OF, UNITS
from ecu_emulator.scenario.faults import SILENCE

OWN_NODE: Final = "TCU"
TIMEOUT_CYCLES: Final = 5
LEAST_TIMEOUT_S: Final = 0.5
STANDSTILL_S: Final = 2.0  # for which nothing at all may be sent before that counts as time; a machine may be slow

_DIFFERENCES: Final[Mapping[str, tuple[str, str]]] = MappingProxyType(
    {
        "clutch1_slip_rad_s": ("hub_speed_rad_s", "input1_speed_rad_s"),
        "lockup_slip_rad_s": ("engine_speed_rad_s", "turbine_speed_rad_s"),
        "clutch2_slip_rad_s": ("hub_speed_rad_s", "input2_speed_rad_s"),
    }
)


@dataclass(slots=True)
class _Sender:
    """One message of another controller: how it is believed, and when it last was."""

    node: str
    timeout_s: float
    id_remainder: int
    due_s: float
    heard_s: float = 0.0


class SentValues:
    """Keeps the last payload of every message; any thread may ask while another one notes.

    Parameters
    ----------
    database
        The messages and their signals.
    clock
        Returns a time [s] that never goes back, for when nothing is sent any more.
    """

    def __init__(self, database: Database, clock: Callable[[], float] = lambda: 0.0) -> None:
        self._carriers: dict[str, tuple[Message, Signal]] = {}
        signals = {signal.name: (message, signal) for message in database.messages for signal in message.signals}
        for quantity, name in SIGNAL_OF.items():
            if name in signals:
                self._carriers[quantity] = signals[name]
        self._clock = clock
        self._payloads: dict[int, bytes] = {}
        self._now_s: float | None = None  # when the newest frame was due
        self._others = {
            contract.can_id: _Sender(
                node=contract.sender,
                timeout_s=max(LEAST_TIMEOUT_S, TIMEOUT_CYCLES * contract.cycle_ms / 1e3),
                id_remainder=profile1.data_id_remainder(contract.data_id or 0),
                due_s=0.0,
            )
            for contract in message_contracts(database).values()
            if contract.sender != OWN_NODE
        }
        self.disbelieved_count = 0  # frames of others whose length or checksum was wrong

    def note(self, can_id: int, payload: bytes, due_s: float = 0.0) -> None:
        """Take a frame that goes out, and when it was due [s]."""
        if self._now_s is None:
            for sender in self._others.values():
                sender.due_s, sender.heard_s = due_s, self._clock()
        self._now_s = max(self._now_s or due_s, due_s)
        other = self._others.get(can_id)
        if other is not None:
            if not _is_sound(payload, other.id_remainder):
                self.disbelieved_count += 1
                return
            other.due_s, other.heard_s = due_s, self._clock()
        self._payloads[can_id] = payload

    def restart(self) -> None:
        """Forget everything, as a controller that is switched on; its senders are waited for from the next frame on."""
        self._payloads = {}
        self._now_s = None

    @property
    def has_begun(self) -> bool:
        """Whether anything has been sent since the start."""
        return self._now_s is not None

    def has_all(self, quantities: Collection[str]) -> bool:
        """Return whether the messages that carry these have been sent, whatever they said of them."""
        return all(self._carriers[quantity][0].frame_id in self._payloads for quantity in quantities)

    def now(self, more: Mapping[str, float]) -> "LatestValues":
        """Return the values of this moment, with others that are on no bus."""
        late = self._late
        payloads = {can_id: payload for can_id, payload in list(self._payloads.items()) if can_id not in late}
        return LatestValues(self._carriers, payloads, more)

    @property
    def silences(self) -> dict[str, float]:
        """Of every other controller whether it has fallen silent, 1 or 0: any message that it has ever sent counts."""
        late, silences = self._late, dict[str, float]()
        for node in {other.node for other in self._others.values()}:
            of_node = {can_id for can_id, other in self._others.items() if other.node == node}
            silences[f"{SILENCE}{node}"] = float(bool(late & (of_node & self._payloads.keys() or of_node)))
        return silences

    @property
    def _late(self) -> set[int]:
        """The messages of others of which nothing that can be believed has come for too long."""
        if self._now_s is None:
            return set()
        clock_s = self._clock()
        return {
            can_id
            for can_id, other in self._others.items()
            if self._now_s - other.due_s > other.timeout_s or clock_s - other.heard_s > other.timeout_s + STANDSTILL_S
        }


def recounted(message: can.Message, data_id: int, first: dict[int, int]) -> can.Message:
    """Return a frame whose alive counter counts from ``first``, by identifier; one that is not sound as it is."""
    if not _is_sound(bytes(message.data), profile1.data_id_remainder(data_id)):
        return message
    data = np.frombuffer(bytes(message.data), np.uint8)[None]
    counter = int(profile1.counter_of(data)[0])
    passed = (counter - first.setdefault(message.arbitration_id, counter)) % profile1.COUNTER_PERIOD
    changed = copy(message)
    changed.data = bytearray(profile1.protect(data, data_id, np.array([passed]))[0].tobytes())
    return changed


def _is_sound(payload: bytes, id_remainder: int) -> bool:
    if len(payload) != profile1.PAYLOAD_BYTES:
        return False
    return bool(profile1.crc_is_valid(np.frombuffer(payload, np.uint8)[None], id_remainder)[0])


class LatestValues(Mapping[str, float]):
    """Values at one moment, by quantity; those that are not known are missing."""

    def __init__(
        self,
        carriers: Mapping[str, tuple[Message, Signal]],
        payloads: Mapping[int, bytes],
        more: Mapping[str, float],
    ) -> None:
        self._carriers = carriers
        self._payloads = payloads
        self._more = more
        self._decoded: dict[int, Mapping[str, object]] = {}

    def __getitem__(self, quantity: str) -> float:
        if quantity in self._more:
            return self._more[quantity]
        if quantity in _DIFFERENCES:
            ahead, behind = _DIFFERENCES[quantity]
            return self[ahead] - self[behind]
        message, signal = self._carriers[quantity]
        raw = self._raw(message)[signal.name]
        if not isinstance(raw, int) or raw == (1 << signal.length) - 1:
            raise KeyError(quantity)  # the code for not available
        value = raw * float(signal.scale) + float(signal.offset)
        return float(UNITS[signal.unit or ""][1](value))

    def __iter__(self) -> Iterator[str]:
        for quantity in (*self._more, *_DIFFERENCES, *self._carriers):
            try:
                self[quantity]
            except KeyError:
                continue
            yield quantity

    def __len__(self) -> int:
        return sum(1 for _ in self)

    def _raw(self, message: Message) -> Mapping[str, object]:
        can_id = message.frame_id
        if can_id not in self._decoded:
            payload = self._payloads[can_id]
            if len(payload) < message.length:
                raise KeyError(can_id)  # a fault of the bus cut it
            self._decoded[can_id] = message.decode_simple(payload, decode_choices=False, scaling=False)
        return self._decoded[can_id]
