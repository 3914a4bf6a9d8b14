"""What candump prints for people: every kind of time and option, beside cantools' reader where that knows them."""

import pytest

from canlog.frames import BRS_FLAG, ERROR_FLAG, ESI_FLAG, EXTENDED_FLAG, FD_FLAG, REMOTE_FLAG, TX_FLAG, FrameBatch
from canlog.logs.candump import ConsoleLog
from canlog.logs.detection import LogFormat, detect
from canlog.logs.log_counts import LogCounts, LogReject
from canlog.logs.text_log import frames_of

BYTES = "11 22 33 44 55 66 77 88"


def read(text: str, counts: LogCounts | None = None) -> tuple[FrameBatch, list[str]]:
    log = ConsoleLog()
    log.look_ahead(text.encode())
    return frames_of(log, text.rstrip("\n").encode(), counts), log.notes


@pytest.mark.parametrize(
    ("line", "can_id", "data", "flags"),
    [
        (f"  can0  0A0   [8]  {BYTES}", 0x0A0, BYTES, 0),
        (f"  can0  0A0   [8]  {BYTES}   '.\"3DUfw.'", 0x0A0, BYTES, 0),
        (
            "  can0  TX - -  18FEF100   [2]  01 02                     '..'",
            0x18FEF100 | EXTENDED_FLAG,
            "01 02",
            TX_FLAG,
        ),
        ("  can0       0A0   [2]  41 42                     'AB'", 0x0A0, "41 42", 0),
        ("  can0  RX B E  123  [12]  " + "5A " * 12, 0x123, "5A " * 12, FD_FLAG | BRS_FLAG | ESI_FLAG),
        ("  can0  123  [00] ", 0x123, "", FD_FLAG),
        ("  can0  123   [3]  03`02`01", 0x123, "01 02 03", 0),
        ("  can0  123   [2]  43`42                     `CB`", 0x123, "42 43", 0),
        ("  can0  123   [2]  00000001 10000000", 0x123, "01 80", 0),
        ("  can0  123   [2]  10000000`00000001", 0x123, "01 80", 0),
        (f"  can0  123  {{F}}  {BYTES}", 0x123, BYTES, 0),
        ("  can0  123   [0]  remote request", 0x123 | REMOTE_FLAG, "", 0),
        ("  can0  20000004   [8]  00 08 00 00 00 00 00 00   ERRORFRAME", ERROR_FLAG | 4, "00 08" + " 00" * 6, 0),
        (" \x1b[1m\x1b[34m can0  0A0   [1]  07\x1b[0m", 0x0A0, "07", 0),
    ],
)
def test_every_kind_of_line_is_read(line: str, can_id: int, data: str, flags: int) -> None:
    batch, _ = read(line + "\n")
    assert batch.can_id.tolist() == [can_id]
    assert bytes(batch.data[0, : batch.length[0]]) == bytes.fromhex(data)
    assert batch.flags.tolist() == [flags]


@pytest.mark.parametrize(
    "line",
    [
        "  can0  0A0   [8]  11 22 33",
        "  can0  0A0   [2]  11 22 33",
        "  can0  0A0   [9]  11 22 33 44 55 66 77 88 99",
        "  can0  123  [10]  " + "5A " * 10,
        "  can0  8FF   [1]  11",
        "  can0  0A0   [2]  41 42                     'AC'",
        "  can0  0A0   [2]  41 42 something",
        "  can0  0A0   [3]  41 42`43",
        "  (12:00) can0  0A0   [1]  41",
        "  (2026-13-01 00:00:00.000000)  can0  0A0   [1]  41",
        "  (9999999999.000000)  can0  0A0   [1]  41",
        "  (9999-01-01 00:00:00.000000)  can0  0A0   [1]  41",
        "  can0  0A0",
        "  can0",
    ],
)
def test_what_is_damaged_is_counted(line: str) -> None:
    counts = LogCounts()
    batch, _ = read(line + "\n", counts)
    assert (len(batch), sum(counts.rejected.values())) == (0, 1)


def times(*stamps: str) -> tuple[list[int], list[str]]:
    batch, notes = read("".join(f" {stamp}  can0  0A0   [1]  {k:02X}\n" for k, stamp in enumerate(stamps)))
    return (batch.t_ns // 1_000).tolist(), notes


def test_times_since_the_start_and_those_since_the_frame_before_are_told_apart() -> None:
    found, notes = times("(000.000000)", "(000.010000)", "(000.030000)", "(001.000000)")
    assert found == [0, 10_000, 30_000, 1_000_000]
    assert "since the start (candump -t z)" in notes[0]
    found, notes = times("(000.000000)", "(000.020000)", "(000.010000)", "(000.030000)", "(000.010000)")
    assert found == [0, 20_000, 30_000, 60_000, 70_000]
    assert "since the frame before (candump -t d)" in notes[0]
    assert times("(000.000000)", "(000.010000)", "(000.010000)")[0] == [0, 10_000, 20_000]  # a single period


def test_identifiers_without_leading_zeros_tell_their_kind_by_their_value() -> None:
    identifiers = ["B3", "2AD", "7", "17F000B7", "3CF", "9AB", "1F00"]
    counts = LogCounts()
    lines = [f"({737 + n / 100:.2f}) RX0 {text} [2] 00 {n:02X}" for n, text in enumerate(identifiers * 8)]
    batch, notes = read("\n".join([*lines, ""]), counts)
    expected = [0x0B3, 0x2AD, 0x007, 0x17F000B7, 0x3CF, 0x9AB, 0x1F00]
    flags = [0, 0, 0, EXTENDED_FLAG, 0, EXTENDED_FLAG, EXTENDED_FLAG]
    assert batch.can_id.tolist() == [value | flag for value, flag in zip(expected, flags, strict=True)] * 8
    assert not counts.rejected
    assert [note for note in notes if "without leading zeros" in note]
    assert detect("\n".join(lines).encode()).format is LogFormat.CONSOLE


def test_one_short_identifier_among_padded_ones_is_damage() -> None:
    counts = LogCounts()
    lines = [f"(1.{n:02d}) can0  {'0A0' if n != 7 else 'A0'}   [1]  {n:02X}" for n in range(40)]
    assert len(read("\n".join([*lines, ""]), counts)[0]) == 39
    assert counts.rejected == {LogReject.MALFORMED: 1}
