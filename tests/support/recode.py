"""A recording of our bus as the traffic of another vehicle: the same drive, coded by another database and profile."""

from collections.abc import Iterable, Mapping
from pathlib import Path

import cantools
import numpy as np
from cantools.database.can import Database, Message

from canlog.arrays import FloatArray, Int64Array, Series
from canlog.database.loading import load_database
from canlog.frames import FrameBatch
from canlog.logs import read_log
from dbc.contract import load_contract
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.shifts.tracking import held_values
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.mapped_messages import MessageColumns, fitting, signal_name
from diag_service.mapping.profile import BusSource, Profile, SignalSource, load_profile, load_shipped

Drive = Mapping[Signal, Series]
LESS = 10.0  # of a signal that is subtracted: some loss
TIMES = 400.0  # of a signal that multiplies: some standard torque
LINE_PRESSURE_PA = 8e5


def columns_of(log: Path | Iterable[FrameBatch], decoder: Decoder) -> dict[Signal, Series]:
    """Return the canonical signals of a whole log, or of its frames."""
    pieces: dict[Signal, list[Series]] = {}
    for batch in read_log(log) if isinstance(log, Path) else log:
        for columns in decoder.feed(batch):
            for signal, series in columns.columns.items():
                pieces.setdefault(signal, []).append(series)
    return {signal: _joined(series) for signal, series in pieces.items()}


def lockup_drive_of(log: Path | Iterable[FrameBatch]) -> dict[Signal, Series]:
    """Return the canonical signals of a recording of our automatic's bus, with those that its controller tells."""
    drive = columns_of(log, Decoder(load_contract("lockup"), load_shipped("lockup")))
    engine, pressure = drive[Signal.ENGINE_SPEED], drive[Signal.LOCKUP_PRESSURE]
    drive[Signal.LOCKUP_SLIP] = _like(engine, engine.value - _at(drive, Signal.TURBINE_SPEED, engine.t_ns))
    drive[Signal.LOCKUP_PRESSURE_COMMAND] = pressure
    drive[Signal.LINE_PRESSURE_COMMAND] = _like(pressure, np.full(len(pressure.t_ns), LINE_PRESSURE_PA))
    return drive


def drive_of(log: Path | Iterable[FrameBatch]) -> dict[Signal, Series]:
    """Return all canonical signals of a recording of our bus, with those that other vehicles have instead of ours."""
    drive = columns_of(log, Decoder(load_contract(), load_profile()))
    target = drive[Signal.TARGET_GEAR]
    engaging = _at(drive, Signal.TARGET_GEAR, target.t_ns) % 2 == 1
    shaft = np.where(engaging, *(_at(drive, one, target.t_ns) for one in (Signal.INPUT1_SPEED, Signal.INPUT2_SPEED)))
    commands = (Signal.CLUTCH1_TORQUE_COMMAND, Signal.CLUTCH2_TORQUE_COMMAND)
    asked = sum(_at(drive, one, target.t_ns) for one in commands)
    direction = np.sign(_at(drive, Signal.ENGINE_SPEED, target.t_ns) - shaft)
    drive[Signal.INPUT_SPEED] = _like(target, shaft)
    drive[Signal.CLUTCH_TORQUE] = _like(target, asked * np.where(direction == 0.0, 1.0, direction))
    return drive


def recoded(drive: Drive, database: Database, profile: Profile) -> list[tuple[int, Message, bytes]]:
    """Return time, message and payload of all frames of a drive in the code of another vehicle, in order of time.

    A message is sent when the first of its signals was sampled; signals that the profile does not map are as near to
    zero as they can be.
    """
    mapped, problems = fitting(database, profile)
    if problems and not profile.is_lenient:
        raise ValueError("; ".join(problems))
    frames = [frame for message in mapped for frame in _frames(drive, message, profile)]
    return sorted(frames, key=lambda frame: frame[0])


def write_candump(path: Path, frames: Iterable[tuple[int, Message, bytes]]) -> None:
    """Write frames as a candump log."""
    with path.open("w", encoding="ascii") as file:
        for t_ns, message, payload in frames:
            identifier = f"{message.frame_id:08X}" if message.is_extended_frame else f"{message.frame_id:03X}"
            file.write(f"({t_ns // 10**9}.{t_ns % 10**9 // 1000:06d}) can0 {identifier}#{payload.hex().upper()}\n")


def recode(log: Path, dbc: Path, profile: Profile, output: Path) -> None:
    """Write a recording of our bus as the traffic of another vehicle."""
    write_candump(output, recoded(drive_of(log), load_database(dbc), profile))


def load_strict(path: Path) -> Database:
    """Return a database that breaks no rule."""
    database = cantools.database.load_file(path, strict=True)
    assert isinstance(database, Database)
    return database


def _frames(drive: Drive, mapped: MessageColumns, profile: Profile) -> Iterable[tuple[int, Message, bytes]]:
    message = mapped.message
    present = [column for column in mapped.columns if column.signal in drive]
    if not present:
        return
    t_ns = drive[present[0].signal].t_ns
    columns: dict[str, FloatArray] = {}
    for column in present:
        source = profile.sources[column.signal]
        zero, one = column.to_si(np.array([0.0, 1.0])).tolist()
        decoded = (_at(drive, column.signal, t_ns) - zero) / (one - zero)
        columns |= _corrected(message, source, decoded)
    names = list(columns)
    base = {signal.name: float(_on_steps(message, signal.name, np.zeros(1))[0]) for signal in message.signals}
    for row, values in zip(t_ns.tolist(), np.column_stack([columns[name] for name in names]).tolist(), strict=True):
        yield row, message, message.encode(base | dict(zip(names, values, strict=True)), strict=False)


def _corrected(message: Message, source: SignalSource, decoded: FloatArray) -> dict[str, FloatArray]:
    """Return the signal of a source, and those that correct it, on the steps of the database."""
    found: dict[str, FloatArray] = {}
    if isinstance(source, BusSource) and source.times is not None:
        found[source.times] = np.full(len(decoded), TIMES)
        decoded = decoded / TIMES
    if isinstance(source, BusSource) and source.less is not None:
        found[source.less] = np.full(len(decoded), LESS)
        decoded = decoded + LESS
    name = signal_name(message, source)
    return {one: _on_steps(message, one, value) for one, value in (found | {name: decoded}).items()}


def _on_steps(message: Message, name: str, value: FloatArray) -> FloatArray:
    signal = message.get_signal_by_name(name)
    raw = np.rint((value - signal.offset) / signal.scale)
    lowest, highest = (
        (-(2 ** (signal.length - 1)), 2 ** (signal.length - 1) - 1) if signal.is_signed else (0, 2**signal.length - 1)
    )
    return np.clip(raw, lowest, highest) * signal.scale + signal.offset


def _at(drive: Drive, signal: Signal, t_ns: Int64Array) -> FloatArray:
    """Return a signal as last sampled at some times."""
    series = drive[signal]
    return held_values(series, t_ns, float(series.value[0]))


def _joined(pieces: list[Series]) -> Series:
    return Series(
        t_ns=np.concatenate([piece.t_ns for piece in pieces]),
        sequence=np.concatenate([piece.sequence for piece in pieces]),
        value=np.concatenate([piece.value for piece in pieces]),
    )


def _like(series: Series, value: FloatArray) -> Series:
    return Series(t_ns=series.t_ns, sequence=series.sequence, value=value)
