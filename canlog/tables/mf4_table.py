"""Decoded signals as MDF 4: a group for each message and channel, its signals as channels that share their times."""

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from typing import Any, BinaryIO, Final

import numpy as np

from canlog.arrays import BoolArray, FloatArray, Int64Array
from canlog.decode.codec import MessageValues
from canlog.extras import load_asammdf
from canlog.tables.account import DecodeAccount
from canlog.tables.frame_groups import FrameGroup, Origins

VERSION: Final = "4.10"
TRANSPOSED_AND_DEFLATED: Final = 2
NS_PER_S: Final = 1_000_000_000


class Mf4Table:
    """An MDF file of signals, by asammdf, which keeps them in a temporary file until they are saved.

    Values that a frame does not carry are marked as invalid. Times count from the second in which the first frame came.

    Raises
    ------
    ExtraMissingError
        If asammdf is not installed.
    """

    def __init__(self, output: BinaryIO, account: DecodeAccount, origins: Origins | None) -> None:
        self._library: Any = load_asammdf("MF4 needs asammdf")
        self._output = output
        self._account = account
        self._codec = account.codec
        self._names = account.names
        self._origins = origins
        self._file: Any = self._library.MDF(version=VERSION)
        self._groups: dict[tuple[int, str], int] = {}
        self._start_ns: int | None = None

    def write_group(self, group: FrameGroup) -> None:
        """Write some frames, message by message."""
        if self._start_ns is None and len(group):
            start_s = int(group.frames.t_ns.min()) // NS_PER_S
            self._start_ns = start_s * NS_PER_S
            self._file.header.start_time = datetime.fromtimestamp(start_s, UTC)
        by_slot: dict[int, list[MessageValues]] = {}
        for one in self._account.values_of(group):
            self._account.row_count += len(one.rows)
            by_slot.setdefault(one.slot, []).append(one)
        for slot, parts in by_slot.items():
            self._write_message(slot, parts, group)

    def close(self) -> None:
        try:
            self._file.save(self._output, compression=TRANSPOSED_AND_DEFLATED)
        finally:
            self._file.close()

    def discard(self) -> None:
        """Write nothing."""
        self._file.close()

    def _write_message(self, slot: int, parts: Sequence[MessageValues], group: FrameGroup) -> None:
        """Write the frames of one message, apart by channel; short frames come apart and are put back in order."""
        found = np.concatenate([part.rows for part in parts])
        order = np.argsort(found, kind="stable")
        rows, columns = found[order], {name: _column(name, parts, order) for name in self._codec.tables[slot].signals}
        channels, logs = group.channel[rows], np.zeros(len(rows), np.int64) if group.log is None else group.log[rows]
        for log, channel in np.unique(np.stack((logs, channels)), axis=1).T.tolist():
            own = (channels == channel) & (logs == log)
            of_channel = {name: (value[own], missing[own]) for name, (value, missing) in columns.items()}
            place = f"channel {channel}" + (f" of {self._origins.names[log]}" if self._origins is not None else "")
            self._append(slot, place, group.frames.t_ns[rows][own], of_channel)

    def _append(
        self, slot: int, place: str, t_ns: Int64Array, columns: Mapping[str, tuple[FloatArray, BoolArray]]
    ) -> None:
        elapsed_s = (t_ns - (self._start_ns or 0)) / NS_PER_S
        group = self._groups.get((slot, place))
        if group is not None:
            self._file.extend(group, [(elapsed_s, None), *columns.values()])
            return
        definitions = self._codec.tables[slot].definitions
        signals = [
            self._library.Signal(
                samples=value,
                timestamps=elapsed_s,
                name=self._names.columns[slot, name],
                unit=definitions[name].unit or "",
                invalidation_bits=is_missing,
            )
            for name, (value, is_missing) in columns.items()
        ]
        name = f"{self._names.messages[slot]}, {place}"
        self._groups[slot, place] = self._file.append(signals, acq_name=name, comment=name, common_timebase=True)


def _column(name: str, parts: Sequence[MessageValues], order: Int64Array) -> tuple[FloatArray, BoolArray]:
    """Return the values of a signal in the order of its frames, and which of them are not there."""
    values, missing = list[FloatArray](), list[BoolArray]()
    for part in parts:
        decoded = part.signals.get(name)
        count = len(part.rows)
        if decoded is None:
            values.append(np.zeros(count))
            missing.append(np.ones(count, np.bool_))
        else:
            values.append(np.asarray(decoded.value, np.float64))
            present = decoded.is_present
            missing.append(np.zeros(count, np.bool_) if present is None else ~present)
    return np.concatenate(values)[order], np.concatenate(missing)[order]
