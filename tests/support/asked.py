"""A recording of our bus as the dialogue of a tester: what a profile asks for, asked as fast as it is answered."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import groupby
from pathlib import Path

import can
import numpy as np

from canlog.arrays import Series
from canlog.frames import EXTENDED_FLAG, FrameBatch, join
from canlog.isotp import segments
from diag_service.diagnosis.columns import Signal
from diag_service.mapping.asked_signals import READ_DATA, READ_LOCAL, DatumId, flagged, sizes_of
from diag_service.mapping.profile import AskedSource, Profile, load_profile, to_si

FRAME_NS = 250_000  # on the bus, with what the controller needs between two
FLOW_CONTROL = bytes([0x30, 0, 0])
NS_PER_S = 1_000_000_000
DEFINED = 0xF300

DSG = """
name = "asked"
[asking]
together = 8
[signals]
engine_speed_rad_s = { did = 0xF40C, at = "7E1", scale = 0.25, unit = "rpm" }
hub_speed_rad_s = { did = 0xF40C, at = "7E1", scale = 0.25, unit = "rpm" }
engine_torque_nm = { did = 0x100C, at = "7E1", signed = true, scale = 0.05, unit = "Nm" }
input1_speed_rad_s = { did = 0x380C, at = "7E1", unit = "rpm" }
input2_speed_rad_s = { did = 0x380D, at = "7E1", unit = "rpm" }
clutch1_pressure_pa = { did = 0x38EB, at = "7E1", signed = true, scale = 0.01, unit = "bar" }
clutch2_pressure_pa = { did = 0x38EA, at = "7E1", signed = true, scale = 0.01, unit = "bar" }
current_gear = { did = 0x3815, at = "7E1", length = 8 }
target_gear = { did = 0x3816, at = "7E1", length = 8 }
sump_temperature_k = { did = 0x2104, at = "7E1", length = 8, offset = -40.0, unit = "degC" }
"""


def asked_profile(folder: Path, text: str = DSG) -> Profile:
    """Return a profile from its text."""
    path = folder / "asked.toml"
    path.write_text(text, encoding="utf-8")
    return load_profile(path)


@dataclass(kw_only=True)
class Wire:
    """Frames of a dialogue as they are written."""

    t_ns: int
    frames: list[tuple[int, int, bytes]] = field(default_factory=list)

    def say(self, payload: bytes, can_id: int, peer_id: int) -> None:
        """Send a message; whoever receives it controls its flow."""
        parts = segments(payload)
        for number, part in enumerate(parts):
            self._put(can_id, part)
            if number == 0 and len(parts) > 1:
                self._put(peer_id, FLOW_CONTROL)

    def _put(self, can_id: int, data: bytes) -> None:
        self.t_ns += FRAME_NS
        self.frames.append((self.t_ns, can_id, data))

    @property
    def batch(self) -> FrameBatch:
        """All of it."""
        data = np.zeros((len(self.frames), 8), np.uint8)
        for row, (_, _, one) in enumerate(self.frames):
            data[row, : len(one)] = list(one)
        return FrameBatch(
            t_ns=np.array([t_ns for t_ns, _, _ in self.frames], np.int64),
            can_id=np.array([flagged(can_id) for _, can_id, _ in self.frames], np.uint32),
            length=np.array([len(one) for _, _, one in self.frames], np.uint8),
            data=data,
        )


def dialogue_of(
    drive: Mapping[Signal, Series],
    profile: Profile,
    rng: np.random.Generator,
    *,
    answer_s: tuple[float, float] = (0.005, 0.04),
    most_per_s: float | None = None,
    together: int | None = None,
    is_defined: bool = False,
) -> FrameBatch:
    """Return the frames by which a tester asks for what a profile names, with what a drive has at those times.

    A value is read some time between its request and its answer. Temperatures are asked for once a second. With
    ``is_defined`` the controller makes one datum of all others first, by service 2C.
    """
    sources = {
        one.asked.data_id: (signal, one) for signal, one in profile.sources.items() if isinstance(one, AskedSource)
    }
    sizes = sizes_of(profile.asked.values())
    slow = [one for one, (signal, _) in sources.items() if signal is Signal.SUMP_TEMPERATURE]
    fast = [one for one in sources if one not in slow]
    most = together or profile.asking.together
    sets = list[list[DatumId]]()
    for (_, service), of_one in groupby(fast, lambda datum: (datum.request_id, datum.service)):
        batch, width = list(of_one), 1 if service == READ_LOCAL else most
        sets += [batch[at : at + width] for at in range(0, len(batch), width)]
    first_ns = max(int(drive[signal].t_ns[0]) for signal, _ in sources.values()) + NS_PER_S // 5
    last_ns = min(int(drive[signal].t_ns[-1]) for signal, _ in sources.values())
    wire, slow_due_ns = Wire(t_ns=first_ns), first_ns
    if is_defined:
        _define(wire, fast, sources, sizes)
    while wire.t_ns < last_ns:
        wanted = list(sets)
        if wire.t_ns >= slow_due_ns and slow:
            wanted.append(slow)
            slow_due_ns += NS_PER_S
        for data in wanted:
            began_ns = wire.t_ns
            _exchange(wire, data, sources, sizes, drive, rng, answer_s, is_defined=is_defined and data is not slow)
            if most_per_s is not None:
                wire.t_ns = max(wire.t_ns, began_ns + round(len(data) * NS_PER_S / most_per_s))
    return wire.batch


def _define(
    wire: Wire,
    data: Sequence[DatumId],
    sources: Mapping[DatumId, tuple[Signal, AskedSource]],
    sizes: Mapping[DatumId, int],
) -> None:
    one = sources[data[0]][1].asked
    parts = b"".join(datum.number.to_bytes(2) + bytes([1, sizes[datum]]) for datum in data)
    wire.say(b"\x2c\x01" + DEFINED.to_bytes(2) + parts, one.request_id, one.reply_id)
    wire.t_ns += 10_000_000
    wire.say(b"\x6c\x01" + DEFINED.to_bytes(2), one.reply_id, one.request_id)


def _exchange(
    wire: Wire,
    data: Sequence[DatumId],
    sources: Mapping[DatumId, tuple[Signal, AskedSource]],
    sizes: Mapping[DatumId, int],
    drive: Mapping[Signal, Series],
    rng: np.random.Generator,
    answer_s: tuple[float, float],
    *,
    is_defined: bool,
) -> None:
    one = sources[data[0]][1].asked
    width = 2 if one.service == READ_DATA else 1
    numbers = b"" if is_defined else b"".join(datum.number.to_bytes(width) for datum in data)
    request = bytes([one.service]) + (DEFINED.to_bytes(2) if is_defined else numbers)
    wire.say(request, one.request_id, one.reply_id)
    asked_ns = wire.t_ns
    wire.t_ns += round(rng.uniform(*answer_s) * NS_PER_S)
    answer = bytes([one.service + 0x40]) + (DEFINED.to_bytes(2) if is_defined else b"")
    read_ns = round(rng.uniform(asked_ns, wire.t_ns))
    for datum in data:
        signal, source = sources[datum]
        raw = raw_value(signal, source, held(drive[signal], read_ns))
        answer += (b"" if is_defined else datum.number.to_bytes(width)) + raw.to_bytes(
            sizes[datum], signed=source.signed
        )
    wire.say(answer, one.reply_id, one.request_id)


def held(series: Series, t_ns: int) -> float:
    """Return what a signal read last."""
    return float(series.value[max(int(np.searchsorted(series.t_ns, t_ns, "right")) - 1, 0)])


def raw_value(signal: Signal, source: AskedSource, si: float) -> int:
    """Return what a controller says for a value."""
    convert = to_si(signal, source, None)
    most = (1 << source.length - source.signed) - 1
    low = -most - 1 if source.signed else 0
    return min(max(round((si - convert.offset) / convert.factor), low), most)


def merged(*batches: FrameBatch) -> FrameBatch:
    """Return the frames of several batches in the order of time."""
    one = join(batches)
    return one[np.argsort(one.t_ns, kind="stable")]


def batch_of(messages: list[can.Message]) -> FrameBatch:
    """Return messages of python-can as columns."""
    data = np.zeros((len(messages), 8), np.uint8)
    for row, one in enumerate(messages):
        data[row, : len(one.data)] = list(one.data)
    return FrameBatch(
        t_ns=np.array([round(one.timestamp * 1e6) * 1000 for one in messages], np.int64),
        can_id=np.array([one.arbitration_id | int(EXTENDED_FLAG) * one.is_extended_id for one in messages], np.uint32),
        length=np.array([len(one.data) for one in messages], np.uint8),
        data=data,
    )


def write_candump(path: Path, batch: FrameBatch) -> None:
    """Write frames as a candump log."""
    with path.open("w", encoding="ascii") as file:
        for t_ns, can_id, length, data in zip(
            batch.t_ns.tolist(), batch.can_id.tolist(), batch.length.tolist(), batch.data, strict=True
        ):
            name = f"{can_id & 0x1FFFFFFF:08X}" if can_id & int(EXTENDED_FLAG) else f"{can_id:03X}"
            payload = data[:length].tobytes().hex().upper()
            file.write(f"({t_ns // NS_PER_S}.{t_ns % NS_PER_S // 1000:06d}) can0 {name}#{payload}\n")
