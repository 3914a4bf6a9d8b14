"""Log files of all formats, told apart by their contents, as batches of frames."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import ExitStack, closing, suppress
from dataclasses import dataclass, replace
from functools import partial
from io import BufferedReader
from pathlib import Path
from typing import BinaryIO, Final, Self, cast

from canlog.database.signal_columns import SignalColumn
from canlog.errors import SourceError
from canlog.files import open_plain_file
from canlog.frames import FrameBatch
from canlog.logs.blf import read_blf
from canlog.logs.captures import read_capture
from canlog.logs.columns import ColumnsLog
from canlog.logs.detection import (
    PROBE_BYTES,
    TEXT_LOGS,
    Detected,
    LogFormat,
    detect,
    has_returns_alone,
    utf_16_of,
)
from canlog.logs.log_counts import (
    BoundedStream,
    LogCounts,
    LogReject,
    TimeWatch,
    bus_load_ratio,
    is_plausible,
    longest_step_ns,
)
from canlog.logs.mf4 import measured_channels, read_mf4
from canlog.logs.signal_tables import all_columns, read_signal_table
from canlog.logs.streams import (
    STANDARD_INPUT,
    InflatedStream,
    PipeStream,
    as_utf_8,
    compression_of,
    never,
    open_standard_input,
    shown_name,
    temporary_log,
    wait_for_reader,
)
from canlog.logs.text_log import reader_of
from canlog.time_order import TimeOrder

LEAST_FRAMES: Final = 8_192  # of a batch, while more are to come: one costs whoever decodes it more than its frames
LOAD_FRAMES = 2_000  # the first ones, whose load is checked
READERS: Mapping[LogFormat, Callable[[BinaryIO, LogCounts], Iterator[FrameBatch]]] = {
    LogFormat.BLF: read_blf,
    LogFormat.MF4: read_mf4,
    LogFormat.PCAP: read_capture,
    LogFormat.PCAPNG: read_capture,
    LogFormat.SIGNALS: read_signal_table,
    **{log_format: reader_of(new_log) for log_format, new_log in TEXT_LOGS.items()},
}

COPY_BYTES: Final = 1024 * 1024


@dataclass(frozen=True, slots=True, kw_only=True)
class Contents:
    """A log to be read."""

    stream: BinaryIO
    detected: Detected
    counts: LogCounts
    is_packed: bool  # the size of its contents is unknown
    columns: str = ""  # as ``--columns`` has it


def contents_of(stream: BinaryIO, columns: str = "") -> Contents:
    """Return the log that an open file is or holds; raises SourceError with the reason if there is none.

    Parameters
    ----------
    stream
        The file, at its beginning.
    columns
        What the columns of a text are; empty if its contents shall say.
    """
    probe = stream.read(PROBE_BYTES)
    stream.seek(0)
    if encoding := utf_16_of(probe):
        with stream:
            return _recoded(stream, encoding, columns)
    compression, counts = compression_of(probe), LogCounts()
    if compression is None and has_returns_alone(probe):
        with stream:
            return _copied(
                (piece.replace(b"\r", b"\n") for piece in iter(lambda: stream.read(COPY_BYTES), b"")), columns
            )
    if compression is None:
        detected = detect(probe, columns)
        return Contents(stream=stream, detected=detected, counts=counts, is_packed=False, columns=columns)
    beginning = _beginning(InflatedStream(stream, compression))
    packed = InflatedStream(stream, compression, counts)
    stream = cast("BinaryIO", packed)
    if encoding := utf_16_of(beginning):
        with packed:
            return replace(_recoded(stream, encoding, columns), counts=counts)
    detected = detect(beginning, columns)
    if detected.format not in TEXT_LOGS:
        with packed:
            stream = cast("BinaryIO", temporary_log(iter(lambda: packed.read(COPY_BYTES), b"")))
    return Contents(stream=stream, detected=detected, counts=counts, is_packed=True, columns=columns)


def _recoded(stream: BinaryIO, encoding: str, columns: str) -> Contents:
    """Return the log that a text of two bytes a character is, as UTF-8."""
    return _copied(as_utf_8(stream, encoding), columns)


def _copied(pieces: Iterable[bytes], columns: str) -> Contents:
    """Return the log that pieces of a text make, in a file that is closed if they make none."""
    with ExitStack() as opened:
        recoded = opened.enter_context(temporary_log(pieces))
        contents = replace(contents_of(recoded, columns), is_packed=True)
        opened.pop_all()
        return contents


def _beginning(packed: InflatedStream) -> bytes:
    """Return the beginning of packed contents, as much as detection looks at."""
    beginning = b""
    while len(beginning) < PROBE_BYTES and (piece := packed.read(PROBE_BYTES - len(beginning))):
        beginning += piece
    if not beginning:
        raise SourceError(f"{packed.name} holds nothing")
    if inner := compression_of(beginning):
        raise SourceError(f"it is packed twice: {inner} inside {packed.name}; unpack it once")
    return beginning


def _reader_of(contents: Contents) -> Callable[[BinaryIO, LogCounts], Iterator[FrameBatch]]:
    if contents.columns and contents.detected.format is LogFormat.COLUMNS:
        return reader_of(partial(ColumnsLog, contents.columns))
    return READERS[contents.detected.format]


class LogReader(Iterator[FrameBatch]):
    """The frames of one log, once, oldest first; only a recording behind another one may begin earlier.

    A strict one stops with an error at the first line, object or record that is no frame and not meant to be anything
    else, at the first jump of time, and where the file is cut off.
    """

    def __init__(self, path: Path, contents: Contents, *, is_strict: bool = False) -> None:
        self.path = path
        self.name = shown_name(path)  # for people
        self.format = contents.detected.format
        self.evidence = contents.detected.evidence  # why it was taken for that
        self.columns = contents.detected.columns  # of a table of signals
        self._counts = contents.counts
        self._stream = contents.stream
        self._is_packed = contents.is_packed
        self._opened = None if path == STANDARD_INPUT else path.stat()
        self._bounded = BoundedStream(self._stream, self._counts)
        if self.format is LogFormat.SIGNALS:  # later rows may name more
            self.columns = all_columns(self._stream)
        if self.format is LogFormat.MF4:
            _, self.columns, notes = measured_channels(self._stream)
            self.evidence += f"; {len(self.columns)} measured channels, no frames of a bus" * bool(self.columns)
            for note in notes:
                self._counts.note(note)
        self._order = TimeOrder(1 if self._bounded.is_live else LEAST_FRAMES)
        self._batches = self._order.ordered(_reader_of(contents)(cast("BinaryIO", self._bounded), self._counts))
        self._watch = TimeWatch(self._counts)
        self._is_strict = is_strict
        self._is_first = True
        self.watch: Callable[[LogReader], object] = lambda _reader: None  # called after each batch, and at the end
        self.has_ended = False

    @property
    def counts(self) -> LogCounts:
        """What has been found until now."""
        self._counts.late, self._counts.most_late_ns = self._order.late_count, self._order.most_late_ns
        return self._counts.snapshot()

    @property
    def longest_step_ns(self) -> int:
        """Longest silence that is no jump of time [ns]; of a table of signals known with its first batch."""
        return self._watch.longest_step_ns

    @property
    def read_bytes(self) -> int:
        """How much of the contents has been read until now."""
        return self._bounded.read_bytes

    @property
    def size_bytes(self) -> int | None:
        """How much there is to be read; None if that cannot be known before."""
        is_as_it_is = not self._is_packed and self.format is not LogFormat.MF4
        return self._opened.st_size if self._opened is not None and is_as_it_is else None

    def __next__(self) -> FrameBatch:
        """Return the next batch.

        Raises
        ------
        InputLeftError
            If the log came through a pipe that was left before its end.
        SourceError
            If the file cannot be read on, its end is reached without a single frame, or a strict reader meets a fault.
        """
        try:
            batch = next(self._batches)
        except StopIteration:
            self._check_size()
            self.close()
            if isinstance(self._stream, PipeStream):
                self._stream.check_not_left()
            self._raise_if_strict()
            if self._counts.frames == 0:
                raise SourceError(f"{self.name}: {self._nothing_found()}") from None
            raise
        except (OSError, SourceError) as exc:
            self._check_size()
            self.close()
            raise named_error(self.name, exc) from exc
        if self._is_first and self.columns:
            self._watch.longest_step_ns = longest_step_ns(batch)
        elif self._is_first:  # (values of a row all have one time)
            self._check_load(batch[:LOAD_FRAMES])
        self._is_first = False
        self._watch.look(batch)
        self._raise_if_strict()
        self.watch(self)
        return batch

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file; reading to the end does it, too."""
        self._stream.close()
        if not self.has_ended:
            self.has_ended = True
            self.watch(self)

    def _check_load(self, batch: FrameBatch) -> None:
        """Say so if the first frames come faster than any bus carries them."""
        load_ratio = bus_load_ratio(batch)
        if load_ratio == float("inf"):
            self._counts.note(f"the first {len(batch)} frames, or those of one channel, all have the same time")
        elif not is_plausible(load_ratio):
            self._counts.note(
                f"the times cannot be right: the first {len(batch)} frames would load a bus of 1 Mbit/s by "
                f"{100 * load_ratio:.0f} %"
            )

    def _check_size(self) -> None:
        """Count it as cut if the file has become shorter since it was opened."""
        if self._opened is None:
            return
        with suppress(OSError):
            now, opened = self.path.stat(), self._opened
            if now.st_ino == opened.st_ino and now.st_size < opened.st_size:
                self._counts.cut_off(f"byte {now.st_size}, where the file shrank while it was read")

    def _raise_if_strict(self) -> None:
        if self._is_strict and (fault := self.counts.first_fault):
            self.close()
            raise SourceError(f"{self.name}: {fault}")

    def _nothing_found(self) -> str:
        counts = self.counts
        if LogReject.GIVEN_UP in counts.rejected:
            return f"no CAN frame in the first megabytes of this {self.format} log, nor anything else of it: given up"
        first = f" ({counts.first_rejected})" if counts.first_rejected else ""
        return f"no CAN frame in this {self.format} log{first}"


Watch = Callable[[LogReader], None]


def read_log(
    path: Path | str,
    *,
    is_strict: bool = False,
    is_stopped: Callable[[], bool] = never,
    watch: Watch | None = None,
    name: str = "",
    columns: str = "",
) -> LogReader:
    """Open a log file, perhaps packed, and return its reader; ``-`` stands for standard input.

    Parameters
    ----------
    path
        The file.
    is_strict
        Whether the first fault is an error.
    is_stopped
        Of standard input: whether to wait no longer for what has not come.
    name
        What it is called for people, if not by its path.
    watch
        Called after each batch, and at the end, with the reader.
    columns
        What the columns of a text are, ``time=Time,id=ID,data=D1-D8``; empty if its contents shall say.

    Raises
    ------
    InputLeftError
        If it was standard input, and left before its format was known.
    SourceError
        If the file is missing, unreadable, empty or not a log of a known format.
    """
    path = Path(path)
    try:
        with ExitStack() as opened:
            if path == STANDARD_INPUT:
                reader = _piped_reader(is_stopped, columns, is_strict=is_strict)
            else:
                stream = opened.enter_context(BufferedReader(open_plain_file(path)))
                reader = LogReader(path, contents_of(stream, columns), is_strict=is_strict)
            reader.name = name or reader.name
            reader.watch = watch or reader.watch
            opened.pop_all()  # from here on it is the reader that closes it
            return reader
    except (OSError, SourceError) as exc:
        raise named_error(name or shown_name(path), exc) from exc


def table_columns(
    path: Path | str, *, is_stopped: Callable[[], bool] = never, columns: str = ""
) -> tuple[SignalColumn, ...]:
    """Return the columns of a table of signals, none of any other log; raises as `read_log`.

    Standard input can be read afterwards, from its beginning.
    """
    if Path(path) != STANDARD_INPUT:
        with read_log(path, columns=columns) as reader:
            return reader.columns
    try:
        stream = open_standard_input(is_stopped)
        detected = _peek(stream, columns)
        if detected is not None and detected.format in TEXT_LOGS:
            wait_for_reader(stream)
            return ()
        file = temporary_log(stream.pieces(is_stopped))
        wait_for_reader(PipeStream(file.fileno(), is_stopped, file=file))
        with (
            BufferedReader(open_plain_file(Path(str(file.name)))) as again,
            LogReader(STANDARD_INPUT, contents_of(again, columns)) as reader,
        ):
            return reader.columns
    except (OSError, SourceError) as exc:
        raise named_error(shown_name(STANDARD_INPUT), exc) from exc


def named_error(name: str, error: OSError | SourceError) -> SourceError:
    """Return what went wrong with a log of some name, for people; a SourceError stays of its kind."""
    kind = type(error) if isinstance(error, SourceError) else SourceError
    reason = getattr(error, "strerror", None) or error
    if isinstance(error, IsADirectoryError):
        reason = "is a folder, not a log file"
    elif isinstance(error, FileNotFoundError):
        reason = "no such file"
    return kind(f"{name}: {reason}")


def _peek(stream: PipeStream, columns: str) -> Detected | None:
    """Return what a pipe is taken for by its beginning, None if it must be unpacked or recoded; rewind it."""
    probe = b""
    while len(probe) < PROBE_BYTES and (piece := stream.read(PROBE_BYTES - len(probe))):
        probe += piece
        if compression_of(probe) is not None or utf_16_of(probe) or _detected(probe) is not None:
            break
    stream.check_not_left()
    stream.give_back(probe)
    if compression_of(probe) is not None or utf_16_of(probe):
        return None
    return detect(probe, columns)


def _piped_reader(is_stopped: Callable[[], bool], columns: str, *, is_strict: bool) -> LogReader:
    """Return the reader of standard input: of a text as it comes, of anything else when all of it is there."""
    stream = open_standard_input(is_stopped)
    detected = _peek(stream, columns)
    if detected is not None and detected.format in TEXT_LOGS:
        pipe = cast("BinaryIO", stream)
        live = Contents(stream=pipe, detected=detected, counts=LogCounts(), is_packed=False, columns=columns)
        return LogReader(STANDARD_INPUT, live, is_strict=is_strict)
    with ExitStack() as opened:
        file = opened.enter_context(temporary_log(stream.pieces(is_stopped)))
        reader = LogReader(STANDARD_INPUT, contents_of(file, columns), is_strict=is_strict)
        opened.pop_all()
        return reader


def _detected(probe: bytes) -> Detected | None:
    """Return what a file is taken for by its beginning, None if that does not suffice."""
    try:
        return detect(probe)
    except SourceError:
        return None


@dataclass(frozen=True, slots=True, kw_only=True)
class Looked:
    """What a file was taken for, or why for nothing."""

    path: Path
    format: LogFormat | None = None
    evidence: str = ""
    reason: str = ""  # why it is no log; empty if it is one


def looked_at(path: Path, columns: str = "") -> Looked:
    """Return what a file is taken for by its first bytes."""
    try:
        with closing(read_log(path, columns=columns)) as reader:
            return Looked(path=path, format=reader.format, evidence=reader.evidence)
    except SourceError as exc:
        return Looked(path=path, reason=str(exc).removeprefix(f"{path}: "))
