"""ASAM MDF 4 bus logs through asammdf, an optional and heavy dependency; whole groups, so memory grows with the file.

Times are floating-point seconds from the start in the file, rounded to whole microseconds here.
"""

import logging
import struct
import zlib
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from io import BytesIO
from typing import Any, BinaryIO, cast

import numpy as np
import numpy.typing as npt

from diag_service.errors import SourceError
from diag_service.frames import ERROR_FLAG, EXTENDED_FLAG, PAYLOAD_BYTES, REMOTE_FLAG, FrameBatch
from diag_service.records import Int64Array, UInt8Array
from diag_service.sources.columns import clear_padding, join, rounded_to_us
from diag_service.sources.tally import LogReject, Tally

Records = npt.NDArray[np.void]  # one row per frame, fields named "CAN_DataFrame.ID" and so on

FRAMES_PER_BATCH = 65_536
NS_PER_S = 1e9
MAX_ID = 0x1FFF_FFFF
DATA, REMOTE, ERROR = "CAN_DataFrame", "CAN_RemoteFrame", "CAN_ErrorFrame"
FLAG_OF_KIND = {DATA: 0, REMOTE: REMOTE_FLAG, ERROR: ERROR_FLAG}

# What asammdf lets through when blocks point nowhere or hold nonsense.
DAMAGE = (OSError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError, struct.error, zlib.error)


@dataclass(frozen=True, slots=True, kw_only=True)
class Asammdf:
    """What is used of asammdf."""

    open_mdf: Callable[..., Any]
    errors: tuple[type[BaseException], ...]


def read_mf4(stream: BinaryIO, tally: Tally) -> Iterator[FrameBatch]:
    """Yield the frames of all CAN groups of an MDF 4 file, merged by time.

    Raises
    ------
    SourceError
        If asammdf is not installed, or the file is damaged or not of version 4.
    """
    asammdf = load_asammdf()
    mdf: Any = None
    try:
        # In memory asammdf may complete what the writer left unfinished.
        mdf = asammdf.open_mdf(BytesIO(stream.read()), process_bus_logging=False)
        start_ns = measurement_start_ns(mdf.header)
        groups = [(number, kind) for number, group in enumerate(mdf.groups) if (kind := frame_kind(group))]
        batches = [read_group(mdf, number, kind, start_ns, tally) for number, kind in groups]
    except asammdf.errors as exc:
        raise SourceError(f"the MF4 file is damaged or cut off: {' '.join(str(exc).split())}") from exc
    finally:
        if mdf is not None:
            mdf.close()
    if not batches:
        return
    merged = join(batches)
    order = np.argsort(merged.t_ns, kind="stable")
    tally.frames += len(merged)
    for first in range(0, len(order), FRAMES_PER_BATCH):
        yield merged[order[first : first + FRAMES_PER_BATCH]]


def load_asammdf() -> Asammdf:
    """Import asammdf, and make it keep to raising errors.

    Raises
    ------
    SourceError
        If it is not installed.
    """
    try:
        from asammdf import MDF  # noqa: PLC0415 - optional, and takes a second to import
        from asammdf.blocks.mdf_v4 import MDF4  # noqa: PLC0415
        from asammdf.blocks.utils import MdfException  # noqa: PLC0415
    except ImportError as exc:
        raise SourceError("MF4 needs the optional package asammdf: pip install 'clutchdiag[mf4]'") from exc
    errors = [MdfException, *DAMAGE]
    with suppress(ImportError):
        from isal.igzip_lib import IsalError  # noqa: PLC0415 - asammdf inflates with it where it is installed

        errors.append(cast("type[Exception]", IsalError))
    # Of a damaged file asammdf logs tracebacks and leaves a half-made object whose end prints one more.
    logging.getLogger("asammdf").setLevel(logging.CRITICAL)
    MDF4.__del__ = end_quietly  # type: ignore[method-assign]
    return Asammdf(open_mdf=MDF, errors=tuple(errors))


def end_quietly(mdf: Any) -> None:  # noqa: ANN401 - asammdf's own object
    """Close an MDF object that may lack what its constructor did not come to."""
    with suppress(AttributeError):
        mdf.close()


def measurement_start_ns(header: Any) -> int:  # noqa: ANN401 - asammdf's own objects
    """Return the start of measurement since the epoch; a local time without a zone counts as this machine's."""
    if header.start_time.tzinfo is None:
        return int(header.start_time.timestamp()) * int(NS_PER_S) + int(header.abs_time) % int(NS_PER_S)
    return int(header.abs_time)


def frame_kind(group: Any) -> str | None:  # noqa: ANN401 - asammdf's own objects
    """Return which kind of CAN frames a group holds, None if it holds something else or nothing."""
    names = {channel.name for channel in group.channels}
    if not group.channel_group.cycles_nr:
        return None
    return next((kind for kind in FLAG_OF_KIND if kind in names), None)


def read_group(mdf: Any, number: int, kind: str, start_ns: int, tally: Tally) -> FrameBatch:  # noqa: ANN401 - asammdf's own objects
    """Return the frames of one group; CAN FD and what is missing at the end is counted."""
    signal = mdf.get(kind, group=number, raw=False)
    samples = signal.samples
    stated = int(mdf.groups[number].channel_group.cycles_nr)
    if len(samples) < stated:
        tally.truncated = True
        tally.reject(LogReject.CUT_OFF, f"record {len(samples) + 1} of group {number}", stated - len(samples))
    can_id = (column(samples, kind, "ID") & MAX_ID).astype(np.uint32)
    can_id |= np.where(column(samples, kind, "IDE") != 0, np.uint32(EXTENDED_FLAG), np.uint32(0))
    can_id |= np.uint32(FLAG_OF_KIND[kind])
    if kind == ERROR:
        can_id[:] = ERROR_FLAG
    stored = column(samples, kind, "DataLength" if kind == DATA else "DLC")
    is_classic = (column(samples, kind, "EDL") == 0) & (stored <= PAYLOAD_BYTES)
    tally.reject(LogReject.CAN_FD, f"group {number}", int(np.count_nonzero(~is_classic)))
    length = np.where(kind == ERROR, 0, np.minimum(stored, PAYLOAD_BYTES)).astype(np.uint8)
    elapsed_ns = np.rint(np.asarray(signal.timestamps, np.float64) * NS_PER_S).astype(np.int64)
    return FrameBatch(
        t_ns=rounded_to_us(start_ns + elapsed_ns)[is_classic],
        can_id=can_id[is_classic],
        length=length[is_classic],
        data=payloads(samples, kind, length)[is_classic],
    )


def column(samples: Records, kind: str, field: str) -> Int64Array:
    """Return one field of the records as integers, zeros if the records lack it."""
    name = f"{kind}.{field}"
    if name not in (samples.dtype.names or ()):
        return np.zeros(len(samples), np.int64)
    values: npt.NDArray[np.int64] = np.asarray(samples[name]).astype(np.int64)
    return values


def payloads(samples: Records, kind: str, length: UInt8Array) -> UInt8Array:
    """Return the payload bytes (n, 8), zeros where there are none."""
    data = np.zeros((len(samples), PAYLOAD_BYTES), np.uint8)
    name = f"{kind}.DataBytes"
    if kind == DATA and name in (samples.dtype.names or ()):
        stored = np.asarray(samples[name], np.uint8).reshape(len(samples), -1)[:, :PAYLOAD_BYTES]
        data[:, : stored.shape[1]] = stored
    return clear_padding(data, length)
