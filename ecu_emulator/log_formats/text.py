"""Logs that are text, a line for each frame: candump, Vector's ASC, PCAN's TRC, and two tables."""

from abc import ABC, abstractmethod
from base64 import b64encode
from datetime import datetime
from typing import BinaryIO, Final

from ecu_emulator.bus.frames import EncodedFrames
from ecu_emulator.log_formats.base import ERROR_FLAG, EXTENDED_FLAG, US_PER_MS, US_PER_S, Header, Int64Array

US_PER_DAY: Final = 86_400_000_000
DAYS_TO_EPOCH: Final = 25_569  # from 1899-12-30 to 1970-01-01
# Not strftime's: the format's names are English in every locale.
DAYS: Final = ("Mon", "Tue", "Wed", "Thu", "Fri", "Sat", "Sun")
MONTHS: Final = ("Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec")


class _TextWriter(ABC):
    """Writes a line for each frame; the formats say which, and what comes before and behind all of them."""

    def __init__(self, stream: BinaryIO, header: Header) -> None:
        self._stream = stream
        self._channel, self._start_us = header.channel, header.start_us
        self._count = 0
        self._stream.write(self._begin().encode())

    def write(self, t_us: Int64Array, frames: EncodedFrames) -> None:
        """Append frames; ``t_us`` are their times in microseconds since the epoch."""
        columns = zip(t_us.tolist(), frames.can_id.tolist(), frames.length.tolist(), frames.data, strict=True)
        lines = list[str]()
        for frame_us, can_id, length, data in columns:
            self._count += 1
            lines.append(self._line(frame_us, can_id, data[:length].tobytes()))
        self._stream.write("".join(lines).encode())

    def close(self) -> None:
        """Hand on what is still buffered; most formats have no end."""
        self._stream.flush()

    def _begin(self) -> str:
        return ""

    @abstractmethod
    def _line(self, t_us: int, can_id: int, payload: bytes) -> str:
        """Return what is written of a frame."""


def _identifier(can_id: int, standard_digits: int = 3) -> str:
    """Return an identifier as three or another number of hexadecimal digits, eight if extended or of an error frame."""
    digits = 8 if can_id & (EXTENDED_FLAG | ERROR_FLAG) else standard_digits
    return f"{can_id & (EXTENDED_FLAG - 1):0{digits}X}"


def _bytes_behind(separator: str, payload: bytes) -> str:
    return separator + payload.hex(separator).upper() if payload else ""


def _seconds(t_us: int) -> str:
    return f"{t_us // US_PER_S}.{t_us % US_PER_S:06d}"


class CandumpWriter(_TextWriter):
    """Writes what ``candump -L`` prints and canplayer plays: ``(1767225600.000000) vcan0 0A0#1122334455667788``."""

    def _line(self, t_us: int, can_id: int, payload: bytes) -> str:
        return f"({_seconds(t_us):0>17}) {self._channel} {_identifier(can_id)}#{payload.hex().upper()}\n"


class AscWriter(_TextWriter):
    """Writes Vector's ASC: times from the start, which is local time without a zone, to the millisecond.

    python-can's writer puts the moment of writing there, so that the same drive would not give the same file.
    """

    def _begin(self) -> str:
        self._start_us = self._start_us // US_PER_MS * US_PER_MS
        start = datetime.fromtimestamp(self._start_us // US_PER_S).astimezone()
        milliseconds = self._start_us % US_PER_S // US_PER_MS
        day, month = DAYS[start.weekday()], MONTHS[start.month - 1]
        date = f"{day} {month} {start.day:02d} {start:%H:%M:%S}.{milliseconds:03d} {start.year:04d}"
        return (
            f"date {date}\nbase hex  timestamps absolute\ninternal events logged\n"
            f"Begin Triggerblock {date}\n   0.000000 Start of measurement\n"
        )

    def _line(self, t_us: int, can_id: int, payload: bytes) -> str:
        name = _identifier(can_id) + ("x" if can_id & EXTENDED_FLAG else "")
        time, data = _seconds(t_us - self._start_us), _bytes_behind(" ", payload)
        return f"{time:0>14} 1  {name}             Rx   d {len(payload)}{data}\n"

    def close(self) -> None:
        """Write the end of the trigger block."""
        self._stream.write(b"End TriggerBlock\n")


class TrcWriter(_TextWriter):
    """Writes PCAN's trace format, version 2.1: milliseconds from the start, which is UTC in days since 1899.

    python-can's writer wants a file with a name, so that it could not write to standard output.
    """

    def _begin(self) -> str:
        days, rest_us = divmod(self._start_us, US_PER_DAY)
        fraction = round(rest_us * 10**14 / US_PER_DAY)  # of a day: finer than a microsecond
        lines = (
            ";$FILEVERSION=2.1",
            f";$STARTTIME={DAYS_TO_EPOCH + days}.{fraction:014d}",
            ";$COLUMNS=N,O,T,B,I,d,R,L,D",
            ";",
            ";   Message   Time    Type    ID     Rx/Tx",
            ";   Number    Offset  |  Bus  [hex]  |  Reserved",
            ";   |         [ms]    |  |    |      |  |  Data Length Code",
            ";   |         |       |  |    |      |  |  |    Data [hex] ...",
            ";---+-- ------+------ +- +- --+----- +- +- +--- +- -- -- -- -- -- -- --",
        )
        return "".join(f"{line}\r\n" for line in lines)

    def _line(self, t_us: int, can_id: int, payload: bytes) -> str:
        milliseconds, rest_us = divmod(t_us - self._start_us, US_PER_MS)
        begin = f"{self._count:>10} {milliseconds:>12}.{rest_us:03d} DT  1 {_identifier(can_id, 4)} Rx -  "
        return f"{begin}{len(payload)}   {_bytes_behind(' ', payload)}\r\n"


class CsvWriter(_TextWriter):
    """Writes what python-can's CSVWriter writes: seconds since the epoch, to the microsecond, payloads in base64."""

    def _begin(self) -> str:
        return "timestamp,arbitration_id,extended,remote,error,dlc,data\n"

    def _line(self, t_us: int, can_id: int, payload: bytes) -> str:
        kind = int(bool(can_id & EXTENDED_FLAG))
        data = b64encode(payload).decode()
        return f"{_seconds(t_us):0>17},0x{_identifier(can_id)},{kind},0,0,{len(payload)},{data}\n"


class GvretWriter(_TextWriter):
    """Writes what SavvyCAN saves as GVRET log: microseconds since the epoch, the bytes padded to eight columns."""

    def _begin(self) -> str:
        return "Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n"

    def _line(self, t_us: int, can_id: int, payload: bytes) -> str:
        kind = "true" if can_id & EXTENDED_FLAG else "false"
        data = _bytes_behind(",", payload.ljust(8, b"\0"))
        return f"{t_us:016d},{_identifier(can_id, 8)},{kind},Rx,0,{len(payload)}{data},\n"
