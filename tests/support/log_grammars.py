"""Logs of any frames in every format that is read, written by python-can, asammdf or by hand: by nothing of ours."""

import base64
import bz2
import gzip
import lzma
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from types import MappingProxyType

import can
import zstandard
from can.io.generic import MessageWriter

CODE_OF_LENGTH = {length: code for code, length in enumerate([*range(9), 12, 16, 20, 24, 32, 48, 64])}
START_S = 1_767_225_600  # 2026-01-01T00:00:00Z: python-can's ASC has trouble with the milliseconds of a start
DAYS_BEFORE_EPOCH = 25_569
GVRET_HEADER = ("Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8",)


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """One frame; a remote or error frame carries no bytes."""

    t_us: int  # since the start
    can_id: int
    is_extended: bool
    length: int
    data: bytes
    is_remote: bool = False
    is_error: bool = False
    is_fd: bool = False
    is_fast: bool = False
    is_passive: bool = False
    is_sent: bool = False
    channel: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Grammar:
    """A format: how it is written, and what it can say."""

    write: Callable[[Path, Sequence[Frame]], None]
    start_us: int = START_S * 1_000_000
    unit_us: int = 1
    step_us: int = 1  # of its times, if they are coarser
    has_fd: bool = False
    has_fd_flags: bool = True
    has_remote: bool = True
    has_error: bool = True
    has_rates: bool = True  # of CAN FD: says whether the bit rate was switched and the sender passive
    has_direction: bool = True
    has_direction_of_errors: bool = False
    first_channel: int = 0
    channels: int = 1
    tells_extended: bool = True  # else an identifier that eleven bits hold is a standard one
    is_always_extended: bool = False
    leaves_open: bool = False  # what its times count from, for one, which is said
    has_passive: bool = True  # of CAN FD: says whether the sender was passive
    is_text: bool = True
    starts_with_a_frame: bool = False  # keeps its start to the millisecond only

    def sayable(self, frame: Frame) -> Frame:
        """Return what of a frame the format can say."""
        is_remote = frame.is_remote and self.has_remote
        is_error = frame.is_error and self.has_error and not is_remote
        is_fd = frame.is_fd and self.has_fd and not is_remote and not is_error
        length = frame.length if is_fd or not frame.is_fd else min(frame.length, 8)
        is_extended = (frame.is_extended and (self.tells_extended or frame.can_id > 0x7FF)) or self.is_always_extended
        return replace(
            frame,
            is_extended=is_extended,
            t_us=frame.t_us * self.unit_us // self.step_us * self.step_us,
            length=0 if is_error else length,
            data=b"" if is_remote or is_error else frame.data[:length],
            is_remote=is_remote,
            is_error=is_error,
            is_fd=is_fd and (self.has_fd_flags or length > 8),
            is_fast=is_fd and frame.is_fast and self.has_fd_flags and self.has_rates,
            is_passive=is_fd and frame.is_passive and self.has_fd_flags and self.has_rates and self.has_passive,
            is_sent=frame.is_sent and self.has_direction and (self.has_direction_of_errors or not is_error),
            channel=frame.channel % self.channels,
        )


def _message(frame: Frame) -> can.Message:
    return can.Message(
        timestamp=START_S + frame.t_us / 1e6,
        arbitration_id=0 if frame.is_error else frame.can_id,
        is_extended_id=frame.is_extended and not frame.is_error,
        is_remote_frame=frame.is_remote,
        is_error_frame=frame.is_error,
        is_fd=frame.is_fd,
        bitrate_switch=frame.is_fast,
        error_state_indicator=frame.is_passive,
        is_rx=not frame.is_sent,
        channel=frame.channel,
        dlc=frame.length,
        data=frame.data,
    )


def _by_python_can(writer: Callable[[Path], MessageWriter]) -> Callable[[Path, Sequence[Frame]], None]:
    def write(path: Path, frames: Sequence[Frame]) -> None:
        with writer(path) as log:
            for frame in frames:
                log.on_message_received(_message(frame))

    return write


def by_hand(
    line: Callable[[int, Frame], str], header: Sequence[str] = (), end: str = "\n"
) -> Callable[[Path, Sequence[Frame]], None]:
    def write(path: Path, frames: Sequence[Frame]) -> None:
        lines = [*header, *(line(number, frame) for number, frame in enumerate(frames, 1))]
        path.write_bytes("".join(one + end for one in lines).encode())

    return write


def hex_text(frame: Frame, separator: str = " ") -> str:
    return frame.data.hex(separator).upper() if separator else frame.data.hex().upper()


def id_text(frame: Frame, digits: int) -> str:
    return f"{frame.can_id:08X}" if frame.is_extended else f"{frame.can_id:0{digits}X}"


def _candump(_: int, frame: Frame) -> str:
    time = f"({START_S + frame.t_us // 1_000_000}.{frame.t_us % 1_000_000:06d}) can{frame.channel}"
    direction = " T" if frame.is_sent else ""
    if frame.is_error:
        return f"{time} 20000000#{direction}"
    if frame.is_remote:
        return f"{time} {id_text(frame, 3)}#R{frame.length}{direction}"
    kind = f"##{frame.is_fast | frame.is_passive << 1:X}" if frame.is_fd else "#"
    return f"{time} {id_text(frame, 3)}{kind}{hex_text(frame, '')}{direction}"


def _trc_1(version: int) -> Callable[[int, Frame], str]:
    def line(number: int, frame: Frame) -> str:
        kind = "Error" if frame.is_error else "Tx" if frame.is_sent else "Rx"
        columns = {
            0: (id_text(frame, 4), frame.length),
            1: (kind, id_text(frame, 4), frame.length),
            2: (frame.channel + 1, kind, id_text(frame, 4), frame.length),
            3: (frame.channel + 1, kind, id_text(frame, 4), "-", frame.length),
        }[version]
        data = "RTR" if frame.is_remote else hex_text(frame)
        return f"{number:6d}) {frame.t_us / 1000:11.1f}  {'  '.join(map(str, columns))}  {data} "

    return line


def _trc_2(*, has_bus: bool) -> Callable[[int, Frame], str]:
    def line(number: int, frame: Frame) -> str:
        kind = "ER" if frame.is_error else "RR" if frame.is_remote else "DT"
        if frame.is_fd:
            kind = {(0, 0): "FD", (1, 0): "FB", (1, 1): "FE", (0, 1): "BI"}[frame.is_fast, frame.is_passive]
        direction, identifier = "Tx" if frame.is_sent else "Rx", "-" if frame.is_error else id_text(frame, 4)
        head = f"{number:7d} {frame.t_us / 1000:13.3f} {kind}"
        if has_bus:
            length = CODE_OF_LENGTH[frame.length]
            return f"{head} {frame.channel + 1} {identifier:>8} {direction} - {length:<4} {hex_text(frame)} "
        if frame.is_error:  # neither an identifier nor a length, as the description of the format shows it
            return f"{head} {'':>8} {direction}    04 00 02 00 00 "
        return f"{head} {identifier:>8} {direction} {frame.length:<2} {hex_text(frame)} "

    return line


def _trc_header(version: str, columns: str = "") -> list[str]:
    names = [f";$COLUMNS={columns}"] if columns else []
    days = START_S / 86_400 + DAYS_BEFORE_EPOCH
    return [f";$FILEVERSION={version}", f";$STARTTIME={days:.10f}", *names, ";", ";   Message   Time"]


def _gvret(start_us: int, time: str) -> Callable[[int, Frame], str]:
    def line(_: int, frame: Frame) -> str:
        head = f"{frame.t_us + start_us:{time}},{frame.can_id:08X},{str(frame.is_extended).lower()}"
        direction = "Tx" if frame.is_sent else "Rx"
        return f"{head},{direction},{frame.channel},{frame.length}," + "".join(f"{byte:02X}," for byte in frame.data)

    return line


def _csv(_: int, frame: Frame) -> str:
    switches = f"{frame.is_extended:d},{frame.is_remote:d},{frame.is_error:d}"
    time = f"{START_S + frame.t_us // 1_000_000}.{frame.t_us % 1_000_000:06d}"
    return f"{time},0x{frame.can_id:x},{switches},{frame.length},{base64.b64encode(frame.data).decode()}"


def busmaster(*, is_decimal: bool) -> Callable[[int, Frame], str]:
    def line(_: int, frame: Frame) -> str:
        minutes, rest_us = divmod(frame.t_us, 60_000_000)
        time = f"{minutes // 60:02d}:{minutes % 60:02d}:{rest_us // 1_000_000:02d}:{rest_us % 1_000_000 // 100:04d}"
        kind = ("x" if frame.is_extended else "s") + ("r" if frame.is_remote else "-fd" if frame.is_fd else "")
        identifier = f"{frame.can_id}" if is_decimal else f"0x{frame.can_id:03X}"
        data = " ".join(f"{byte:03d}" for byte in frame.data) if is_decimal else hex_text(frame)
        direction = "Tx" if frame.is_sent else "Rx"
        return f"{time} {direction} {frame.channel + 1} {identifier} {kind} {frame.length} {data} "

    return line


def busmaster_header(base: str, protocol: str = "CAN") -> list[str]:
    start = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=START_S)
    local = start.astimezone()
    date = f"{local.day}:{local.month}:{local.year} {local.hour}:{local.minute}:{local.second}:0"
    return [
        "***BUSMASTER Ver 3.2.2***",
        f"***PROTOCOL {protocol}***",
        f"***START DATE AND TIME {date}***",
        f"***{base}***",
        "***ABSOLUTE MODE***",
        "***<Time><Tx/Rx><Channel><CAN ID><Type><DLC><DataBytes>***",
    ]


def _crtd(_: int, frame: Frame) -> str:
    time = f"{START_S + frame.t_us // 1_000_000}.{frame.t_us % 1_000_000:06d}"
    kind = f"{frame.channel or ''}{'T' if frame.is_sent else 'R'}{29 if frame.is_extended else 11}"
    return f"{time} {kind} {id_text(frame, 3)} {hex_text(frame)}"


GRAMMARS: Mapping[str, Grammar] = MappingProxyType({
    "candump": Grammar(write=by_hand(_candump), has_fd=True, channels=10, has_direction_of_errors=True),
    "candump of python-can": Grammar(
        write=_by_python_can(can.CanutilsLogWriter), has_fd=True, channels=10, has_error=False, has_remote=False
    ),
    "blf": Grammar(
        write=_by_python_can(can.BLFWriter), has_fd=True, channels=20, first_channel=1, is_text=False,
    ),
    "asc": Grammar(
        write=_by_python_can(can.ASCWriter), has_fd=True, channels=20, first_channel=1, starts_with_a_frame=True
    ),
    "mf4": Grammar(
        write=_by_python_can(can.MF4Writer), has_fd=True, channels=20, is_text=False, has_direction_of_errors=True
    ),
    "trc 1.0": Grammar(
        write=by_hand(_trc_1(0), _trc_header("1.0")), unit_us=100, has_error=False, has_direction=False
    ),
    "trc 1.1": Grammar(write=by_hand(_trc_1(1), _trc_header("1.1"), "\r\n"), unit_us=100),
    "trc 1.2": Grammar(write=by_hand(_trc_1(2), _trc_header("1.2")), unit_us=100, channels=9, first_channel=1),
    "trc 1.3": Grammar(write=by_hand(_trc_1(3), _trc_header("1.3")), unit_us=100, channels=9, first_channel=1),
    "trc 2.0": Grammar(
        write=by_hand(_trc_2(has_bus=False), _trc_header("2.0", "N,O,T,I,d,l,D")),
        has_fd=True, has_direction_of_errors=True,
    ),
    "trc 2.1": Grammar(
        write=by_hand(_trc_2(has_bus=True), _trc_header("2.1", "N,O,T,B,I,d,R,L,D"), "\r\n"),
        has_fd=True, has_direction_of_errors=True, channels=9, first_channel=1,
    ),
    "csv": Grammar(write=by_hand(_csv), has_fd=True, has_fd_flags=False, has_direction=False),
    "csv of python-can": Grammar(
        write=_by_python_can(can.CSVWriter), has_fd=True, has_fd_flags=False, has_direction=False
    ),
    "gvret": Grammar(
        write=by_hand(_gvret(0, "d"), GVRET_HEADER),
        start_us=0, has_fd=True, has_fd_flags=False, has_remote=False, has_error=False, channels=10,
    ),
    "gvret below zero": Grammar(
        write=by_hand(_gvret(-50_000, "d"), GVRET_HEADER),
        start_us=-50_000, has_fd=True, has_fd_flags=False, has_remote=False, has_error=False, channels=10,
    ),
    "gvret with exponents": Grammar(
        write=by_hand(_gvret(-50_000, ".9E"), GVRET_HEADER),
        start_us=-50_000, has_fd=True, has_fd_flags=False, has_remote=False, has_error=False, channels=10,
    ),
    "busmaster": Grammar(
        write=by_hand(busmaster(is_decimal=False), busmaster_header("HEX")),
        unit_us=100, has_fd=True, has_rates=False, has_error=False, channels=9, first_channel=1,
    ),
    "busmaster in decimal": Grammar(
        write=by_hand(busmaster(is_decimal=True), busmaster_header("DEC")),
        unit_us=100, has_fd=True, has_rates=False, has_error=False, channels=9, first_channel=1,
    ),
    "crtd": Grammar(
        write=by_hand(_crtd), has_remote=False, has_error=False, channels=10,
    ),
})  # fmt: skip


PACKERS: Mapping[str, Callable[[bytes], bytes]] = MappingProxyType(
    {"plain": bytes, "gzip": gzip.compress, "xz": lzma.compress, "bzip2": bz2.compress, "zstd": zstandard.compress}
)
