"""What the controllers of the vehicle say at this moment: the frames that were last on the bus, in SI.

Noise, sensor faults and lost values are in them as on the bus. What others say is believed while it is fresh and its
checksum fits; what this controller senses itself, it knows.
"""

from collections.abc import Callable, Collection, Mapping
from copy import copy
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import can
import numpy as np
from cantools.database.can import Database
from cantools.database.can.signal import Signal

from canlog.e2e import profile1
from canlog.e2e.message_contract import message_contracts
from ecu_emulator.bus.frames import QUANTITY_OF, UNITS
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
    """Keeps what every message said last; any thread may ask while another one notes.

    Parameters
    ----------
    database
        The messages and their signals.
    clock
        Returns a time [s] that never goes back, for when nothing is sent any more.
    """

    def __init__(self, database: Database, clock: Callable[[], float] = lambda: 0.0) -> None:
        self._messages = {message.frame_id: message for message in database.messages}
        self._carriers = {
            QUANTITY_OF[signal.name]: can_id
            for can_id, message in self._messages.items()
            for signal in message.signals
            if signal.name in QUANTITY_OF
        }
        self._clock = clock
        self._values: dict[int, dict[str, float]] = {}  # by identifier
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
        self._values[can_id] = self._decoded(can_id, payload)

    def restart(self) -> None:
        """Forget everything, as a controller that is switched on; its senders are waited for from the next frame on."""
        self._values = {}
        self._now_s = None

    @property
    def has_begun(self) -> bool:
        """Whether anything has been sent since the start."""
        return self._now_s is not None

    def has_all(self, quantities: Collection[str]) -> bool:
        """Return whether the messages that carry these have been sent, whatever they said of them."""
        return all(self._carriers[quantity] in self._values for quantity in quantities)

    def now(self, more: Mapping[str, float]) -> dict[str, float]:
        """Return the values of this moment, with others that are on no bus; those that are not known are missing."""
        late, values = self._late, dict[str, float]()
        for can_id, decoded in list(self._values.items()):
            if can_id not in late:
                values |= decoded
        for quantity, (ahead, behind) in _DIFFERENCES.items():
            if ahead in values and behind in values:
                values[quantity] = values[ahead] - values[behind]
        return {**values, **more}

    def _decoded(self, can_id: int, payload: bytes) -> dict[str, float]:
        """Return what a frame says [SI]: nothing if a fault of the bus cut it, or nobody knows it."""
        message = self._messages.get(can_id)
        if message is None or len(payload) < message.length:
            return {}
        raws = message.decode_simple(payload, decode_choices=False, scaling=False)
        return {
            QUANTITY_OF[signal.name]: _si(raw, signal)
            for signal in message.signals
            if signal.name in QUANTITY_OF
            and isinstance(raw := raws[signal.name], int)
            and raw != (1 << signal.length) - 1  # the code for not available
        }

    @property
    def silences(self) -> dict[str, float]:
        """Of every other controller whether it has fallen silent, 1 or 0: any message that it has ever sent counts."""
        late, silences = self._late, dict[str, float]()
        for node in {other.node for other in self._others.values()}:
            of_node = {can_id for can_id, other in self._others.items() if other.node == node}
            silences[f"{SILENCE}{node}"] = float(bool(late & (of_node & self._values.keys() or of_node)))
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


def _si(raw: int, signal: Signal) -> float:
    return float(UNITS[signal.unit or ""][1](raw * float(signal.scale) + float(signal.offset)))
