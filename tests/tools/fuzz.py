"""Hypothesis against the readers of our own, for as long as one likes.

Pieces of sound logs and arbitrary bytes, shuffled: reading ends without an error of another kind than ours, frames are
those of the columns' rules, and every line of a text is accounted for. BLF is tried twice, as a file and with the
objects inside its containers changed before they are packed; logs that are packed are changed in what they are
packed in.

    python -m tests.tools.fuzz --reader candump --minutes 10
"""

import argparse
import bz2
import gzip
import io
import lzma
import sys
import tempfile
import time
import zlib
from collections.abc import Callable, Iterable, Iterator
from itertools import pairwise
from pathlib import Path
from typing import BinaryIO

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import zstandard
from hypothesis import HealthCheck, given, seed, settings
from hypothesis import strategies as st

from canlog.errors import SourceError
from canlog.frames import ERROR_FLAG, EXTENDED_FLAG, FD_FLAG, FrameBatch
from canlog.logs.arrow_tables import read_arrow_table
from canlog.logs.asc import AscLog
from canlog.logs.blf import read_blf
from canlog.logs.candump import CandumpLog
from canlog.logs.captures import read_capture
from canlog.logs.detection import TEXT_LOGS, LogFormat
from canlog.logs.log_counts import LogCounts
from canlog.logs.reading import read_log
from canlog.logs.signal_tables import read_signal_table
from canlog.logs.text_kernels import IS_LENGTH
from canlog.logs.text_log import LOOK_AHEAD_BYTES, ends_by_returns, reader_of
from ecu_emulator.log_formats.writers import (
    CONTAINER_HEADER,
    DEFLATED,
    FILE_HEADER,
    LOG_CONTAINER,
    OBJECT_MAGIC,
    AscWriter,
    BlfWriter,
    CandumpWriter,
    CsvWriter,
    FrameWriter,
    GvretWriter,
    Header,
    TrcWriter,
)
from tests.support import measurements
from tests.support.capture_grammars import COOKED, COOKED_2, SOCKETCAN, pcap, pcapng
from tests.support.log_grammars import Frame
from tests.support.traffic import START_NS, as_received, random_frames
from tests.tools.damage.garbling import inflated_containers

EXAMPLES_PER_ROUND = 500
STORED = 0  # a container that is not deflated
Reader = Callable[[BinaryIO, LogCounts], Iterator[FrameBatch]]


def written(writer: type[FrameWriter]) -> bytes:
    """Return a sound log of a few frames."""
    frames = random_frames(40)
    stream = io.BytesIO()
    log = writer(stream, Header(start_us=START_NS // 1000, channel="vcan0"))
    log.write(as_received(frames).t_ns // 1000, frames)
    log.close()
    return stream.getvalue()


TRC_START = b";$STARTTIME=46023.5000000000\r\n;\r\n"
TRC_COLUMNS = {b"2.0": b"N,O,T,I,d,l,D", b"2.1": b"N,O,T,B,I,d,R,L,D"}
TRC_LINES = {
    b"1.0": b"     1)      1841.5  18FEF100  3  11 22 33 \r\n     2)      1842.0  0300  2  RTR \r\n",
    b"1.1": b"     1)      1841.5  Rx  18FEF100  3  11 22 33 \r\n     2)      1842.0  Error  0004  1  02 \r\n",
    b"1.2": b"     1)      1841.5  1  Rx  18FEF100  3  11 22 33 \r\n     2)      1842.0  2  Tx  0300  2  RTR \r\n",
    b"1.3": b"     1)      1841.5  1  Rx  18FEF100  -  3  11 22 33 \r\n     2)   1842.0  2  Tx  0300  -  2  RTR \r\n",
    b"2.0": b"      1      1059.900 DT     0300 Rx 3  11 22 33 \r\n      2      1060.0 FB 18FEF100 Tx 12  "
    + b"11 " * 12
    + b"\r\n      3      1061.0 ER          Rx    04 00 02 00 00 \r\n      4      1062.0 RR     0300 Rx 2  \r\n",
    b"2.1": b"      1      1059.900 DT 1     0300 Rx - 3    11 22 33 \r\n      2      1060.0 ST 1 - Rx - 4 00 01 \r\n"
    b"      3      1061.0 FE 2 18FEF100 Tx - 9    " + b"11 " * 12 + b"\r\n",
}
TRC = tuple(
    b";$FILEVERSION=" + version + b"\r\n" + TRC_START + b";$COLUMNS=" * (version in TRC_COLUMNS)
    + TRC_COLUMNS.get(version, b";") + b"\r\n" + lines
    for version, lines in TRC_LINES.items()
)  # fmt: skip
BUSMASTER = (
    b"***BUSMASTER Ver 3.2.2***\n***START DATE AND TIME 1:2:2026 23:59:37:325***\n***SYSTEM MODE***\n"
    b"23:59:37:3329 Rx 1 0x144 s 1 5E\n00:00:07:3347 Tx 2 0x18FEF100 x 8 5F 00 11 22 33 44 55 66\n"
    b"0:0:9:3 Rx 1 0x7 sr 3\n***PROTOCOL J1939***\n"
    b"14:24:01:3995 1 1ceaff00 0x00EA00 RQST_ACL 00  FF  007 Tx 3 00 EE 00 \n"
    b"***DEC***\n14:24:01:3996 2 485162752 0x00EA00 RQST_ACL 00  FF  007 Rx 2 000 238 \n"
)
BUSMASTER_J1939 = tuple(
    b"***BUSMASTER Ver 3.2.2***\n***PROTOCOL J1939***\n***START DATE AND TIME 1:2:2026 23:59:37:325***\n***"
    + base + b"***\n***ABSOLUTE MODE***\n" + lines
    for base, lines in (
        (b"HEX", b"00:00:01:3995 1 1ceaff00 0x00EA00 RQST_ACL 00  FF  007 Tx 3 00 EE 00 \n"),
        (b"DEC", b"00:00:01:3996 2 485162752 0x00EA00 RQST_ACL 00  FF  007 Rx 2 000 238 \n"),
    )
)  # fmt: skip
CONSOLE_GAPS = b"".join(
    b" (%03d.%06d)  can%d  18FEF100   [3]  11 22 33\n" % (number % 3, number * 997, number % 2) for number in range(20)
)
CONSOLE = (
    b"  (000.000000)  can0  TX B -  0A0   [8]  11 22 33 44 55 66 77 88   '.\"3DUfw.'\n"
    b' (000.010000)  can1  18FEF100   [3]  11`22`33   `3".`\n (001.0)  can0  123   [2]  remote request\n'
    b" (2026-01-31 23:59:59.000001)  can0  RX - E  123  [12]  01 02 03 04 05 06 07 08 09 0A 0B 0C\n"
    b"  can0  20000004   [8]  00 08 00 00 00 00 00 00   ERRORFRAME\n\tcontroller-problem{}\n"
    b"  \x1b[1m\x1b[34mcan0  123   [2]  00000001 10000000\x1b[0m\nDROPCOUNT: dropped 3 CAN frames on 'can0' socket\n"
)
CLX000 = tuple(
    b'# Logger type: CL2000\n# Time: 20170101T022232\n# Value separator: "%s"\nTimestamp%sType%sID%sData\n'
    % ((mark,) * 4)
    + b"".join(
        time + mark + kind + mark + b"18fef100" + mark + b"02010d5555555555\n"
        for time, kind in ((b"01T022231683", b"8"), (b"22231.688", b"0"), (b"2017/12/31T23:59:59.999", b"9"))
    )
    for mark in (b";", b"\t")
)
COLUMNS = (
    b"Line,Abs Time(Sec),Rel Time (Sec),Status,Er,Tx,Description,Network,Node,Arb ID,Remote,Xtd,"
    b"B1,B2,B3,B4,B5,B6,B7,B8\n1,2550.36,0.003,67371008,F,F,HS CAN $119,HS CAN2,,119,F,F,00,00,00,00,00,00,0D,8B\n"
    b'2,2550.37,0.003,67371008,F,T,"a, b",HS CAN,,18FEF100,F,T,01,02,,,,,,\n3,1e3,0,0,T,F,,HS CAN,,,F,F,,,,,,,,\n'
    b"4,2026-01-31T23:59:59.5+01:00,0,0,F,F,,HS CAN,,7FFh,T,F,,,,,,,,\n5,23:59:59.999,,,,,,,,0x98FEF100,,,ff\n"
)
CRTD = b"1320745424.000 CXX log\n1320745424.002 1R11 402 FA 01 C3 A0 96 00 07 01\n1320745424.1 2T29 18FEF100 07 64\n"
SOUND_BLF = written(BlfWriter)
SOUND_OBJECTS = b"".join(inflated_containers(SOUND_BLF))


def capture(write: Callable[[Path, list[Frame]], None]) -> bytes:
    """Return a capture of a few frames of all lengths."""
    frames = [
        Frame(t_us=1_000 * number, can_id=0x123 + number, is_extended=number % 2 == 1, length=length,
              data=bytes(range(length)), is_fd=length > 8)
        for number, length in enumerate((0, 3, 8, 12, 64, 8, 8))
    ]  # fmt: skip
    with tempfile.NamedTemporaryFile() as file:
        write(Path(file.name), frames)
        return Path(file.name).read_bytes()


PCAP = tuple(capture(pcap(link, order)) for link in (SOCKETCAN, COOKED, COOKED_2) for order in "<>")
PCAPNG = tuple(capture(pcapng(link, order, has_others=True)) for link in (SOCKETCAN, COOKED) for order in "<>")
SOUND_CANDUMP = written(CandumpWriter)
PACKED = {
    "gzip": gzip.compress(SOUND_CANDUMP, mtime=0),
    "bzip2": bz2.compress(SOUND_CANDUMP),
    "xz": lzma.compress(SOUND_CANDUMP),
    "zstd": zstandard.compress(SOUND_CANDUMP),
}


def read_packed(stream: BinaryIO, counts: LogCounts) -> Iterator[FrameBatch]:
    """Read a log from a file, as it is read that one names."""
    with tempfile.NamedTemporaryFile() as file:
        file.write(stream.read())
        file.flush()
        reader = read_log(Path(file.name))
        try:
            yield from reader
            counts.add(reader.counts)
        finally:
            reader.close()


SIGNALS = (
    b"Time [ms],Speed [rpm],Cut,Note\n" + b"".join(b"%d,%d.5,on,ok\n" % (37 * row, 900 + row) for row in range(30)),
    b"a recorder\nZeit;Druck\ns;kPa\n" + b"".join(b"%d,5;%d,86\n" % (row, row) for row in range(30)),
    b"Time\tA\tA\n" + b"".join(b'23:59:%02d\t"%d"\t\n' % (row, row) for row in range(30)),
)


def arrow_tables() -> tuple[bytes, ...]:
    """Return a small table of signals as Parquet, as an Arrow file and as a stream."""
    columns = {"t_s": np.arange(40) / 50.0, "Speed": np.arange(40.0), "Gear": np.arange(40) // 10}
    table, outs = pa.table(columns), [io.BytesIO() for _ in range(3)]
    pq.write_table(table, outs[0])
    for out, opened in zip(outs[1:], (pa.ipc.new_file, pa.ipc.new_stream), strict=True):
        with opened(out, table.schema) as writer:
            writer.write_table(table)
    return tuple(out.getvalue() for out in outs)


def measurement() -> bytes:
    """Return an MF4 file of measured channels in two groups, of which one has invalid values."""
    fast_s, slow_s = np.arange(40) / 50.0, np.arange(10) / 10.0
    with tempfile.NamedTemporaryFile(suffix=".mf4") as file:
        speed = measurements.Measured("Speed", "rpm", 900.0 + fast_s, 0.25)
        heat = measurements.Measured("Heat", "degC", 80.0 + slow_s, invalid=slow_s > 0.5)
        measurements.written(Path(file.name), [(fast_s, [speed]), (slow_s, [heat])])
        return Path(file.name).read_bytes()


ARROW_TABLES = arrow_tables()
READERS: dict[str, tuple[Reader, bytes | tuple[bytes, ...]]] = {
    "candump": (
        reader_of(CandumpLog),
        written(CandumpWriter) + b"(1.0) can1 123##5" + b"5A" * 12 + b"\n(1.0) can0 123#R4\n",
    ),
    "asc": (
        reader_of(AscLog),
        written(AscWriter) + b"1.5 CANFD 2 Rx 123 1 0 9 12 " + b"11 " * 12 + b"0 0 303000 0 0 0\n",
    ),
    "blf": (read_blf, SOUND_BLF),
    "blf-objects": (read_blf, SOUND_OBJECTS),
    "pcap": (read_capture, PCAP),
    "pcapng": (read_capture, PCAPNG),
    "trc": (reader_of(TEXT_LOGS[LogFormat.TRC]), (*TRC, written(TrcWriter))),
    "csv": (reader_of(TEXT_LOGS[LogFormat.CSV]), written(CsvWriter)),
    "gvret": (reader_of(TEXT_LOGS[LogFormat.GVRET]), written(GvretWriter)),
    "busmaster": (reader_of(TEXT_LOGS[LogFormat.BUSMASTER]), (BUSMASTER, *BUSMASTER_J1939)),
    "crtd": (reader_of(TEXT_LOGS[LogFormat.CRTD]), CRTD),
    "console": (reader_of(TEXT_LOGS[LogFormat.CONSOLE]), (CONSOLE, CONSOLE_GAPS)),
    "clx000": (reader_of(TEXT_LOGS[LogFormat.CLX000]), CLX000),
    "columns": (reader_of(TEXT_LOGS[LogFormat.COLUMNS]), COLUMNS),
    "signals": (read_signal_table, SIGNALS),
    "arrow": (read_arrow_table, ARROW_TABLES),
    "measured": (read_packed, measurement()),
    "packed": (read_packed, tuple(PACKED.values())),
}
ALONE = {f"packed-{name}": (read_packed, sound) for name, sound in PACKED.items()}
WITHOUT_LINES = ("blf", "pcap", "packed", "signals", "arrow", "measured")
ALPHABET = st.sampled_from(b"0123456789ABCDEFabcdefx#()., \t\r\n;*:-_=TRrd$\0\xff").map(lambda value: bytes([value]))


def contents(sound: bytes) -> st.SearchStrategy[bytes]:
    """Return logs of pieces of a sound one, of characters of the grammars, and of anything."""
    lines = st.sampled_from(sound.splitlines(keepends=True))
    places = st.tuples(st.integers(0, len(sound)), st.integers(0, 200))
    pieces = places.map(lambda place: sound[place[0] : place[0] + place[1]])
    mixed = st.lists(st.one_of(lines, pieces, ALPHABET, st.binary(max_size=40)), max_size=30).map(b"".join)
    changes = st.lists(st.tuples(st.integers(0, len(sound) - 1), st.integers(0, 255)), max_size=8)
    return st.one_of(
        mixed, mixed.map(lambda rest: sound[:200] + rest), changes.map(lambda found: changed(sound, found))
    )


def packed(objects: bytes, cuts: list[int]) -> bytes:
    """Return a BLF file that holds these objects in several containers, every other one deflated."""
    edges = [0, *sorted(min(place, len(objects)) for place in cuts), len(objects)]
    found = SOUND_BLF[: FILE_HEADER.size]
    for number, (first, last) in enumerate(pairwise(edges)):
        piece = objects[first:last]
        stored, method = (zlib.compress(piece), DEFLATED) if number % 2 else (piece, STORED)
        size = CONTAINER_HEADER.size + len(stored)
        found += CONTAINER_HEADER.pack(OBJECT_MAGIC, 16, 1, size, LOG_CONTAINER, method, len(piece)) + stored
        found += bytes(size % 4)
    return found


def packed_contents(sound: bytes) -> st.SearchStrategy[bytes]:
    """Return BLF files whose objects are anything."""
    return st.builds(packed, contents(sound), st.lists(st.integers(0, len(sound)), max_size=4))


def changed(sound: bytes, changes: list[tuple[int, int]]) -> bytes:
    """Return a log with some of its bytes changed."""
    found = bytearray(sound)
    for place, value in changes:
        found[place] = value
    return bytes(found)


def check(reader: Reader, text: bytes, *, has_lines: bool) -> None:
    """Read a log and check what must hold of any."""
    counts, frames = LogCounts(), 0
    try:
        for batch in reader(io.BytesIO(text), counts):
            check_batch(batch)
            frames += len(batch)
    except SourceError:
        return
    assert frames == counts.frames
    if has_lines:
        whole = (text.replace(b"\r", b"\n") if ends_by_returns(text[:LOOK_AHEAD_BYTES]) else text).count(b"\n")
        accounted = counts.frames + counts.skipped + sum(counts.rejected.values())
        assert whole <= accounted
        assert accounted <= whole + 1 or counts.notes  # a line of several frames is said


def check_batch(batch: FrameBatch) -> None:
    """Check the rules of the columns."""
    assert len(batch) == len(batch.can_id) == len(batch.length) == len(batch.data) == len(batch.flags)
    assert (batch.t_ns % 1000 == 0).all()
    assert IS_LENGTH[batch.length].all()
    assert ((batch.length <= 8) | (batch.flags & FD_FLAG != 0)).all()
    number = batch.can_id & np.uint32(0x1FFF_FFFF)
    is_standard = (batch.can_id & np.uint32(EXTENDED_FLAG | ERROR_FLAG)) == 0
    assert (number[is_standard] <= 0x7FF).all()
    assert not batch.data[np.arange(batch.width) >= batch.length[:, None]].any()


def seeds(first: int, minutes: float) -> Iterator[int]:
    """Return the numbers of the rounds: one after the other until the time is over, and one in any case."""
    end_s = time.monotonic() + 60.0 * minutes
    yield first
    while time.monotonic() < end_s:
        first += 1
        yield first


def fuzz(name: str, of_rounds: Iterable[int], *, examples: int = EXAMPLES_PER_ROUND) -> int:
    """Fuzz one reader, a round for each of the numbers that its logs come from; return how many logs it read."""
    reader, sound = (READERS | ALONE)[name]
    sounds = sound if isinstance(sound, tuple) else (sound,)
    logs = st.one_of([(packed_contents if name == "blf-objects" else contents)(one) for one in sounds])
    rounds = 0
    for of_round in of_rounds:

        @seed(of_round)
        @settings(max_examples=examples, deadline=None, database=None, suppress_health_check=list(HealthCheck))
        @given(logs)
        def one_round(text: bytes) -> None:
            check(reader, text, has_lines=not name.startswith(WITHOUT_LINES))

        one_round()
        rounds += 1
    return rounds * examples


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--reader", choices=READERS | ALONE, action="append", help="default: all, one by one; packed is all packed-..."
    )
    parser.add_argument("--minutes", type=float, default=10.0, help="for each reader")
    parser.add_argument("--seed", type=int, default=1)
    options = parser.parse_args()
    for name in options.reader or READERS:
        print(f"{name}: {fuzz(name, seeds(options.seed, options.minutes))} logs read, nothing wrong", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
