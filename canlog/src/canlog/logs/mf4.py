"""The frames of ASAM MDF 4 bus logs through asammdf, an optional and heavy dependency.

Times are floating-point seconds from the start in the file, rounded to whole microseconds here.
"""

import logging
import shutil
import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from canlog.arrays import UInt8Array
from canlog.errors import SourceError
from canlog.extras import load_asammdf
from canlog.frames import (
    BRS_FLAG,
    ERROR_FLAG,
    ESI_FLAG,
    EXTENDED_FLAG,
    FD_FLAG,
    FD_PAYLOAD_BYTES,
    PAYLOAD_BYTES,
    REMOTE_FLAG,
    TX_FLAG,
    FrameBatch,
    clear_padding,
    rounded_to_us,
)
from canlog.logs.log_counts import LogCounts, LogReject
from canlog.logs.merging import merged_by_time
from canlog.logs.mf4_channels import UNFINISHED_MAGIC, Untyped, channel_batches, measured_channels, one_each
from canlog.logs.text_kernels import IS_LENGTH

Records = npt.NDArray[np.void]  # one row per frame, fields named "CAN_DataFrame.ID" and so on

IntegerArray = npt.NDArray[np.integer[Any]]

FRAMES_PER_READ = 262_144
NS_PER_S = 1e9
MAX_STANDARD_ID, MAX_ID = 0x7FF, 0x1FFF_FFFF
DATA, REMOTE, ERROR = "CAN_DataFrame", "CAN_RemoteFrame", "CAN_ErrorFrame"
FLAG_OF_KIND = {DATA: 0, REMOTE: REMOTE_FLAG, ERROR: ERROR_FLAG}
LAST_S = 9.2e9
NEEDS_ASAMMDF = "MF4 needs the optional package asammdf"

# What asammdf lets through when blocks point nowhere or hold nonsense.
DAMAGE = (OSError, ValueError, LookupError, TypeError, AttributeError, ArithmeticError, struct.error, zlib.error,
          NameError, RuntimeError, MemoryError)  # fmt: skip


def read_mf4(stream: BinaryIO, counts: LogCounts) -> Iterator[FrameBatch]:
    """Yield the frames of all CAN groups of an MDF 4 file, else its measured channels, merged by time.

    Raises SourceError if asammdf is not installed, or the file is damaged or not of version 4.
    """
    asammdf, errors = quiet_asammdf()
    path = Path(stream.name)
    size_bytes = path.stat().st_size
    with TemporaryDirectory(prefix="clutchdiag-") as folder:
        try:
            yield from _batches(asammdf, path, Path(folder), counts)
        except errors as exc:
            if path.stat().st_size < size_bytes:
                counts.cut_off("where the file shrank while it was read")
                return
            raise SourceError(f"the MF4 file is damaged or cut off: {' '.join(str(exc).split())}") from exc


def _batches(asammdf: Untyped, path: Path, folder: Path, counts: LogCounts) -> Iterator[FrameBatch]:
    mdf: Untyped = None
    try:
        with path.open("rb") as original:
            measured = measured_channels(original)
            is_unfinished = counts.unfinished = original.read(len(UNFINISHED_MAGIC)) == UNFINISHED_MAGIC
        if is_unfinished:  # asammdf completes it where it is
            path = Path(shutil.copy(path, folder / "unfinished.mf4"))
        # Of a stream rows are read in pieces; a path would be mapped, and a file that shrinks then ends the program.
        with path.open("r+b" if is_unfinished else "rb") as opened:
            mdf = asammdf.MDF(opened, process_bus_logging=False, temporary_folder=folder)
            start_ns = int(mdf.header.abs_time)
            if mdf.header.start_time.tzinfo is None:  # a local time without a zone counts as this machine's
                start_ns = int(mdf.header.start_time.timestamp()) * int(NS_PER_S) + start_ns % int(NS_PER_S)
            kinds = {number: kind for number, group in enumerate(mdf.groups) if (kind := frame_kind(group))}
            streams = [read_group(mdf, number, kind, start_ns, counts) for number, kind in kinds.items()]
            if measured.groups:
                streams = channel_batches(mdf, measured, path.stat().st_size, start_ns, counts)
            for batch in merged_by_time(streams):
                counts.frames += len(batch)
                yield batch
    finally:
        if mdf is not None:
            end_quietly(mdf)


def quiet_asammdf() -> tuple[Untyped, tuple[type[Exception], ...]]:
    """Return asammdf, made to keep to raising errors, and what it raises of a damaged file.

    Raises ExtraMissingError if it is not installed.
    """
    asammdf = load_asammdf(NEEDS_ASAMMDF)
    # Of a damaged file it logs tracebacks, and leaves a half-made object whose end prints one more.
    logging.getLogger("asammdf").setLevel(logging.CRITICAL)
    asammdf.blocks.mdf_v4.MDF4.__del__ = end_quietly
    errors = [asammdf.blocks.utils.MdfException, *DAMAGE]
    with suppress(ImportError):
        errors.append(import_module("isal.igzip_lib").IsalError)  # it inflates with it where it is installed
    return asammdf, tuple(errors)


def end_quietly(mdf: Untyped) -> None:
    """Close an MDF object that may lack what its constructor did not come to."""
    with suppress(AttributeError, OSError):
        mdf.close()


def frame_kind(group: Untyped) -> str | None:
    """Return which kind of CAN frames a group holds, None if it holds something else or nothing."""
    names = {channel.name for channel in group.channels}
    if not group.channel_group.cycles_nr:
        return None
    return next((kind for kind in FLAG_OF_KIND if kind in names), None)


def read_group(mdf: Untyped, number: int, kind: str, start_ns: int, counts: LogCounts) -> Iterator[FrameBatch]:
    """Yield the frames of one group; what is missing at its end is counted."""
    stated, done = int(mdf.groups[number].channel_group.cycles_nr), 0
    while done < stated:
        signal = mdf.get(
            kind, group=number, raw=False, record_offset=done, record_count=min(FRAMES_PER_READ, stated - done)
        )
        if not len(signal.samples):
            counts.cut_off(f"record {done + 1} of group {number}", stated - done)
            return
        try:
            batch, is_frame = frames_of(signal.samples, np.asarray(signal.timestamps, np.float64), kind, start_ns)
        except (SourceError, *DAMAGE) as exc:
            raise SourceError(f"group {number}, {kind}: {exc}") from exc
        bad = np.flatnonzero(~is_frame)
        if len(bad):
            counts.reject(LogReject.MALFORMED, f"record {done + int(bad[0]) + 1} of group {number}", len(bad))
        done += len(signal.samples)
        yield batch[is_frame] if len(bad) else batch


def frames_of(
    samples: Records, elapsed_s: npt.NDArray[np.float64], kind: str, start_ns: int
) -> tuple[FrameBatch, npt.NDArray[np.bool_]]:
    if kind != ERROR and f"{kind}.ID" not in (samples.dtype.names or ()):
        raise SourceError("no channel holds the identifiers")
    number = column(samples, kind, "ID").astype(np.uint32) & np.uint32(MAX_ID)
    is_extended = column(samples, kind, "IDE") != 0
    is_fd = column(samples, kind, "EDL") != 0
    stored = column(samples, kind, "DataLength" if kind == DATA else "DLC")
    is_time = np.isfinite(elapsed_s) & (np.abs(elapsed_s) < LAST_S - start_ns / NS_PER_S)
    is_length = (stored >= 0) & (stored <= FD_PAYLOAD_BYTES) & IS_LENGTH[np.clip(stored, 0, FD_PAYLOAD_BYTES)]
    is_fd |= stored > PAYLOAD_BYTES
    is_frame = is_time & ((is_length & (is_extended | (number <= MAX_STANDARD_ID))) | (kind == ERROR))
    length = np.where(is_length & (kind != ERROR), stored, 0).astype(np.uint8)
    can_id = number | np.where(is_extended, np.uint32(EXTENDED_FLAG), np.uint32(0))
    flags = np.where(is_sent(samples, kind), np.uint8(TX_FLAG), np.uint8(0))
    if is_fd.any():
        fast, passive = (column(samples, kind, field) != 0 for field in ("BRS", "ESI"))
        flags |= (is_fd * (FD_FLAG | BRS_FLAG * fast | ESI_FLAG * passive)).astype(np.uint8)
    elapsed_ns = np.rint(np.where(is_time, elapsed_s, 0.0) * NS_PER_S).astype(np.int64)
    batch = FrameBatch(
        t_ns=rounded_to_us(start_ns + elapsed_ns),
        can_id=np.full(len(length), ERROR_FLAG, np.uint32) if kind == ERROR else can_id | np.uint32(FLAG_OF_KIND[kind]),
        length=length,
        data=payloads(samples, kind, length, FD_PAYLOAD_BYTES if is_fd.any() else PAYLOAD_BYTES),
        flags=flags,
        channel=np.clip(column(samples, kind, "BusChannel"), 0, 255).astype(np.uint8),
    )
    return batch, is_frame


def is_sent(samples: Records, kind: str) -> npt.NDArray[np.bool_]:
    """Return which frames the recorder sent itself: a number, or the text that a conversion makes of it."""
    name = f"{kind}.Dir"
    if name not in (samples.dtype.names or ()):
        return np.zeros(len(samples), np.bool_)
    values = one_each(samples[name], "bSiuf", name)
    sent: npt.NDArray[np.bool_] = (np.char.lower(values) == b"tx") if values.dtype.kind == "S" else values == 1
    return sent


def column(samples: Records, kind: str, field: str) -> IntegerArray:
    """Return one field of the records as integers, zeros if the records lack it."""
    name = f"{kind}.{field}"
    if name not in (samples.dtype.names or ()):
        return np.zeros(len(samples), np.uint8)
    values = one_each(samples[name], "biuf", name)
    return values if values.dtype.kind == "u" else values.astype(np.int64)


def payloads(samples: Records, kind: str, length: UInt8Array, width: int) -> UInt8Array:
    """Return the payload bytes (n, width), zeros where there are none."""
    data = np.zeros((len(samples), width), np.uint8)
    name = f"{kind}.DataBytes"
    if kind == DATA and name in (samples.dtype.names or ()):
        if samples[name].dtype != np.uint8:
            raise SourceError(f"{name}: not bytes, but {samples[name].dtype}")
        stored = samples[name].reshape(len(samples), -1)[:, :width]
        data[:, : stored.shape[1]] = stored
    return data if (length == width).all() else clear_padding(data, length)
