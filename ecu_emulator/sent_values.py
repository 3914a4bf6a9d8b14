"""What the controllers of the vehicle say at this moment: the frames that were last on the bus, in SI.

Decoded when somebody asks, not when they are sent: noise, sensor faults and lost values are in them as on the bus.
"""

from collections.abc import Callable, Collection, Iterator, Mapping
from types import MappingProxyType
from typing import Final

from cantools.database.can import Database, Message
from cantools.database.can.signal import Signal

from clutch_model.units import k_from_degc, m_s_from_km_h, pa_from_bar, rad_s_from_rpm
from ecu_emulator.frames import SIGNAL_OF

_TO_SI: Final[Mapping[str, Callable[[float], float]]] = MappingProxyType(
    {
        "rpm": rad_s_from_rpm,
        "bar": pa_from_bar,
        "kPa": lambda pressure_kpa: pressure_kpa * 1e3,
        "degC": k_from_degc,
        "km/h": m_s_from_km_h,
        "%": lambda percent: percent / 100.0,
    }
)
_DIFFERENCES: Final[Mapping[str, tuple[str, str]]] = MappingProxyType(
    {
        "clutch1_slip_rad_s": ("hub_speed_rad_s", "input1_speed_rad_s"),
        "clutch2_slip_rad_s": ("hub_speed_rad_s", "input2_speed_rad_s"),
    }
)


class SentValues:
    """Keeps the last payload of every message; any thread may ask while another one notes.

    Parameters
    ----------
    database
        The messages and their signals.
    """

    def __init__(self, database: Database) -> None:
        self._carriers: dict[str, tuple[Message, Signal]] = {}
        signals = {signal.name: (message, signal) for message in database.messages for signal in message.signals}
        for quantity, name in SIGNAL_OF.items():
            if name in signals:
                self._carriers[quantity] = signals[name]
        self._payloads: dict[int, bytes] = {}

    def note(self, can_id: int, payload: bytes) -> None:
        """Take a frame that goes out."""
        self._payloads[can_id] = payload

    def has_all(self, quantities: Collection[str]) -> bool:
        """Return whether the messages that carry these have been sent, whatever they said of them."""
        return all(self._carriers[quantity][0].frame_id in self._payloads for quantity in quantities)

    def now(self, more: Mapping[str, float]) -> "Moment":
        """Return the values of this moment, with others that are on no bus."""
        return Moment(self._carriers, dict(self._payloads), more)


class Moment(Mapping[str, float]):
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
        return _TO_SI.get(signal.unit or "", float)(value)

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
