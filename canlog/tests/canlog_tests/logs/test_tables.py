"""Text tables: what each format's lines mean, and that no line goes uncounted."""

from datetime import datetime

import pytest

from canlog.frames import BRS_FLAG, ERROR_FLAG, ESI_FLAG, EXTENDED_FLAG, FD_FLAG, REMOTE_FLAG, TX_FLAG, FrameBatch
from canlog.logs.detection import TEXT_LOGS, LogFormat
from canlog.logs.log_counts import LogCounts, LogReject
from canlog.logs.text_log import reader_of
from tests.support.batches import read_whole

CSV_HEADER = b"timestamp,arbitration_id,extended,remote,error,dlc,data\n"
GVRET_HEADER = b"Time Stamp,ID,Extended,Dir,Bus,LEN,D1,D2,D3,D4,D5,D6,D7,D8\n"
TRC_21 = b";$FILEVERSION=2.1\r\n;$STARTTIME=46023.5\r\n;$COLUMNS=N,O,T,B,I,d,R,L,D\r\n"
NOON_NS = 1_767_268_800_000_000_000  # 2026-01-01T12:00:00Z, day 46023.5
BUSMASTER = (
    b"***BUSMASTER Ver 3.2.2***\n***PROTOCOL CAN***\n***START DATE AND TIME 1:2:2026 23:59:37:325***\n***HEX***\n"
    b"***%s MODE***\n***<Time><Tx/Rx><Channel><CAN ID><Type><DLC><DataBytes>***\n"
)
LOCAL_START = datetime(2026, 2, 1, 23, 59, 37, 325_000)  # noqa: DTZ001 - local, as in the format

Row = tuple[int, int, int, str, int, int]  # time, identifier, length, payload, flags, channel


def read(log_format: LogFormat, text: bytes) -> tuple[FrameBatch, LogCounts]:
    return read_whole(reader_of(TEXT_LOGS[log_format]), text)


def rows(batch: FrameBatch) -> list[Row]:
    assert not any(batch.data[row, length:].any() for row, length in enumerate(batch.length))
    return [
        (int(t_ns), int(can_id), int(length), bytes(data[:length]).hex(), int(flags), int(channel))
        for t_ns, can_id, length, data, flags, channel in zip(
            batch.t_ns, batch.can_id, batch.length, batch.data, batch.flags, batch.channel, strict=True
        )
    ]


@pytest.mark.parametrize(
    ("log_format", "header", "line", "row"),
    [
        (LogFormat.CSV, CSV_HEADER, b"1767225600.123456,0x123,1,0,0,8,AQIDBAUGBwg=",
         (1_767_225_600_123_456_000, 0x123 | EXTENDED_FLAG, 8, "0102030405060708", 0, 0)),
        (LogFormat.CSV, CSV_HEADER, b"1e-05,0x7ff,0,1,0,3,", (10_000, 0x7FF | REMOTE_FLAG, 3, "000000", 0, 0)),
        (LogFormat.CSV, CSV_HEADER, b"0.5,0x1,0,0,1,0,", (500_000_000, ERROR_FLAG, 0, "", 0, 0)),
        (LogFormat.CSV, CSV_HEADER, b"2.0,0x1,0,0,0,12,AQIDBAUGBwgJCgsM",
         (2 * 10**9, 1, 12, "0102030405060708090a0b0c", FD_FLAG, 0)),
        (LogFormat.GVRET, b"Time Stamp,ID,Extended,Bus,LEN,D1\n",
         b"166064000,0000021A,false,1,2,FE,36,12,FE,69,05,07,AD,", (166_064_000_000, 0x21A, 2, "fe36", 0, 1)),
        (LogFormat.GVRET, GVRET_HEADER, b"166064000,18FEF100,true,Rx,0,3,5,A,00",
         (166_064_000_000, 0x18FE_F100 | EXTENDED_FLAG, 3, "050a00", 0, 0)),
        (LogFormat.GVRET, GVRET_HEADER, b"7,00000123,false,Tx,2,16," + b",".join([b"5A"] * 16),
         (7_000, 0x123, 16, "5a" * 16, FD_FLAG | TX_FLAG, 2)),
        (LogFormat.GVRET, GVRET_HEADER, b"-2000001,123,false,Rx,0,0", (-2_000_001_000, 0x123, 0, "", 0, 0)),
        (LogFormat.GVRET, GVRET_HEADER, b"1.66064E+08,123,false,Rx,0,0", (166_064_000_000, 0x123, 0, "", 0, 0)),
        (LogFormat.GVRET, GVRET_HEADER, b"-1.5e3,123,false,Rx,0,0", (-1_500_000, 0x123, 0, "", 0, 0)),
        (LogFormat.GVRET, GVRET_HEADER, b"+25e-1,123,false,Rx,0,0", (3_000, 0x123, 0, "", 0, 0)),
        (LogFormat.GVRET, GVRET_HEADER, b"0E+00,123,false,,0,0", (0, 0x123, 0, "", 0, 0)),
        (LogFormat.CSV, CSV_HEADER, b"1.5E+2,0x1,0,0,0,0,", (150 * 10**9, 1, 0, "", 0, 0)),
        (LogFormat.TRC, b";   Start time: 01.01.2026 12:00:00.682.0\n",
         b"  1)     1841 0001 8 00 11 22 33 44 55 66 77", (NOON_NS + 2_523_000_000, 1, 8, "0011223344556677", 0, 0)),
        (LogFormat.TRC, b"; no date\n", b"  2)  1842 0008 4 ERROR 00 19 08 08",
         (1_842_000_000, ERROR_FLAG, 0, "", 0, 0)),
        (LogFormat.TRC, b";$FILEVERSION=1.1\n;$STARTTIME=46023.5\n", b"  1)   2.5  Rx   18FEF100  3  RTR",
         (NOON_NS + 2_500_000, 0x18FE_F100 | EXTENDED_FLAG | REMOTE_FLAG, 3, "000000", 0, 0)),
        (LogFormat.TRC, b";$FILEVERSION=1.2\n;$STARTTIME=46023.5\n", b"  1)   2.5 2  Tx   0300  1  0A",
         (NOON_NS + 2_500_000, 0x300, 1, "0a", TX_FLAG, 2)),
        (LogFormat.TRC, b";$FILEVERSION=1.3\n;$STARTTIME=46023.5\n", b"  1)   2.5 1  Rx   0300 -  2  0A 0B",
         (NOON_NS + 2_500_000, 0x300, 2, "0a0b", 0, 1)),
        (LogFormat.TRC, b";$FILEVERSION=2.0\n;$STARTTIME=46023.5\n;$COLUMNS=N,O,T,I,d,l,D\n",
         b"  1   1059.900 DT   0300 Rx 2  0A 0B", (NOON_NS + 1_059_900_000, 0x300, 2, "0a0b", 0, 0)),
        (LogFormat.TRC, TRC_21, b"  1   1059.900 FE 2  18EFC034 Tx -  9    01 02 03 04 05 06 07 08 09 0A 0B 0C \r",
         (NOON_NS + 1_059_900_000, 0x18EF_C034 | EXTENDED_FLAG, 12, "0102030405060708090a0b0c",
          FD_FLAG | BRS_FLAG | ESI_FLAG | TX_FLAG, 2)),
        (LogFormat.TRC, TRC_21, b"  5      0.001 RR 1      0100 Rx -  3 \r",
         (NOON_NS + 1_000, 0x100 | REMOTE_FLAG, 3, "000000", 0, 1)),
        (LogFormat.TRC, TRC_21, b"  3   1.0005 ER 1  - Rx -  5  04 00 02 00 00 \r",
         (NOON_NS + 1_001_000, ERROR_FLAG, 0, "", 0, 1)),
        (LogFormat.TRC, b";$FILEVERSION=2.0\n;$STARTTIME=46023.5\n;$COLUMNS=N,O,T,I,d,l,D\n",
         b"  6   1334.522 ER          Tx    0B 00 02 00 00 ",
         (NOON_NS + 1_334_522_000, ERROR_FLAG, 0, "", TX_FLAG, 0)),
        (LogFormat.CRTD, b"1320745424.000 CXX converted log\n", b"1320745424.002 2R29 18FEF100 FA 01",
         (1_320_745_424_002_000_000, 0x18FE_F100 | EXTENDED_FLAG, 2, "fa01", 0, 2)),
        (LogFormat.CRTD, b"12.5 CEV Event\n", b"12.6 T11 402", (12_600_000_000, 0x402, 0, "", TX_FLAG, 0)),
    ],
)  # fmt: skip
def test_a_line_becomes_a_frame(log_format: LogFormat, header: bytes, line: bytes, row: Row) -> None:
    batch, counts = read(log_format, header + line + b"\n")
    assert rows(batch) == [row]
    assert counts == LogCounts(frames=1, skipped=header.count(b"\n"))


@pytest.mark.parametrize(
    ("mode", "elapsed_us"),
    [
        (b"SYSTEM", [7_900, 30_009_700, 32_009_700]),  # over midnight, the last line an hour behind nothing
        (b"ABSOLUTE", [86_377_332_900, 7_334_700, 9_334_700]),
        (b"RELATIVE", [86_377_332_900, 86_384_667_600, 86_394_002_300]),
    ],
)
def test_busmaster_has_three_kinds_of_time(mode: bytes, elapsed_us: list[int]) -> None:
    lines = b"23:59:37:3329 Rx 1 0x144 s 1 5E\n00:00:07:3347 Tx 2 0x18FEF100 x 1 5F\n0:0:9:3347 Rx 1 0x7 sr 3\n"
    batch, counts = read(LogFormat.BUSMASTER, BUSMASTER % mode + lines)
    start_us = int(LOCAL_START.timestamp()) * 10**6 + 325_000
    assert (batch.t_ns // 1000 - start_us).tolist() == elapsed_us
    assert batch.can_id.tolist() == [0x144, 0x18FE_F100 | EXTENDED_FLAG, 0x7 | REMOTE_FLAG]
    assert batch.channel.tolist() == [1, 2, 1]
    assert counts == LogCounts(frames=3, skipped=6)


@pytest.mark.parametrize(
    ("log_format", "header", "line"),
    [
        (LogFormat.CSV, CSV_HEADER, b"0.5,0x1,0,0,0,2,AQ=="),
        (LogFormat.CSV, CSV_HEADER, b"0.5,0x1,0,0,0,1,AQ="),
        (LogFormat.CSV, CSV_HEADER, b"0.5,0x800,0,0,0,1,AQ=="),
        (LogFormat.CSV, CSV_HEADER, b"0.5,0x1,2,0,0,1,AQ=="),
        (LogFormat.CSV, CSV_HEADER, b"nan,0x1,0,0,0,1,AQ=="),
        (LogFormat.CSV, CSV_HEADER, b"99999999999999999999,0x1,0,0,0,1,AQ=="),
        (LogFormat.CSV, CSV_HEADER, b"99999999999999999,0x1,0,0,0,1,AQ=="),
        (LogFormat.CSV, CSV_HEADER, b"time,0x1,0,0,0,1,AQ=="),
        (LogFormat.CSV, CSV_HEADER, b"0.5,0x1,0,0,0,1,AQ==,1"),
        (LogFormat.GVRET, GVRET_HEADER, b"7,00000123,false,Rx,0,2,5A"),
        (LogFormat.GVRET, GVRET_HEADER, b"7,00000123,false,Rx,0,2,5A,5G"),
        (LogFormat.GVRET, GVRET_HEADER, b"7,00000123,maybe,Rx,0,1,5A"),
        (LogFormat.GVRET, GVRET_HEADER, b"--7,00000123,false,Rx,0,1,5A"),
        (LogFormat.GVRET, GVRET_HEADER, b"-,00000123,false,Rx,0,1,5A"),
        (LogFormat.GVRET, GVRET_HEADER, b"7e,00000123,false,Rx,0,1,5A"),
        (LogFormat.GVRET, GVRET_HEADER, b"7E+99,00000123,false,Rx,0,1,5A"),
        (LogFormat.GVRET, GVRET_HEADER, b"-7E+17,00000123,false,Rx,0,1,5A"),
        (LogFormat.GVRET, GVRET_HEADER, b"7,3FFFFFFF,true,Rx,0,1,5A"),
        (LogFormat.GVRET, GVRET_HEADER, b"7,00000123,false,Rx,0,9,1,2,3,4,5,6,7,8,9"),
        (LogFormat.TRC, TRC_21, b"  1   1.0 DT 1  0300 Rx -  2  0A 0B 0C"),
        (LogFormat.TRC, TRC_21, b"  1   1.0 DT 1  0300 Rx -  2  0A 0"),
        (LogFormat.TRC, TRC_21, b"  1   1.0 DT 1  0300 Rx -  2  0A0B"),
        (LogFormat.TRC, TRC_21, b"  1   1.0 XX 1  0300 Rx -  1  0A"),
        (LogFormat.TRC, TRC_21, b"  1   1.0 DT 1  0800 Rx -  1  0A"),
        (LogFormat.TRC, TRC_21, b";$FILEVERSION=7.3"),
        (LogFormat.TRC, TRC_21, b";$COLUMNS=N,O,Q"),
        (LogFormat.TRC, TRC_21, b";$STARTTIME=1"),
        (LogFormat.BUSMASTER, BUSMASTER % b"SYSTEM", b"16:49:37:3329 Rx 1 0x144 s 2 5E"),
        (LogFormat.BUSMASTER, BUSMASTER % b"SYSTEM", b"24:00:00:0000 Rx 1 0x144 s 1 5E"),
        (LogFormat.BUSMASTER, BUSMASTER % b"SYSTEM", b"16:60:37:3329 Rx 1 0x144 s 1 5E"),
        (LogFormat.BUSMASTER, BUSMASTER % b"SYSTEM", b"16:49:37:3329 Rx 1 0x144 q 1 5E"),
        (LogFormat.CRTD, b"", b"12.6 Q11 402 00"),
        (LogFormat.CRTD, b"", b"12.6 R11 402 0"),
        (LogFormat.CRTD, b"", b"12.6 can0R11 402 00"),  # events have three letters
        (LogFormat.CRTD, b"", b"\xff\x00\x80"),
    ],
)
def test_what_is_no_frame_is_counted_with_its_line(log_format: LogFormat, header: bytes, line: bytes) -> None:
    batch, counts = read(log_format, header + b"\n" + line + b"\n")
    number = header.count(b"\n") + 2
    assert len(batch) == 0
    assert counts.rejected == {LogReject.MALFORMED: 1}
    assert counts.first_rejected == f"line {number}: malformed"
    assert counts.skipped == number - 1


def test_times_below_zero_of_many_years_are_amounts_since_1970() -> None:
    start_us = 1_769_872_318_259_854
    lines = [f"{-start_us + 1000 * n},00000141,false,Rx,0,2,1A,{n:02X},\n" for n in range(20)]
    batch, counts = read(LogFormat.GVRET, GVRET_HEADER + "".join(lines).encode())
    assert batch.t_ns.tolist() == [(start_us + 1000 * n) * 1000 for n in range(20)]
    assert "times are below zero: their amounts are taken as microseconds since 1970" in counts.notes
