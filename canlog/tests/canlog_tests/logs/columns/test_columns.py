"""Tables by the names of their columns: what is proposed, what one says oneself, and what is left open."""

import pytest

from canlog.errors import SourceError
from canlog.frames import EXTENDED_FLAG, REMOTE_FLAG, FrameBatch
from canlog.logs.columns import ColumnsLog
from canlog.logs.detection import LogFormat, detect
from canlog.logs.log_counts import LogCounts
from canlog.logs.text_log import TextLog, frames_of


def read(log: TextLog, text: str) -> tuple[FrameBatch, LogCounts]:
    counts = LogCounts()
    log.look_ahead(text.encode())
    return frames_of(log, text.rstrip("\n").encode(), counts), counts


def rows(batch: FrameBatch) -> list[tuple[int, int, str]]:
    return [
        (int(t_ns) // 1_000, int(can_id), bytes(data[:length]).hex())
        for t_ns, can_id, data, length in zip(batch.t_ns, batch.can_id, batch.data, batch.length, strict=True)
    ]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("ID,Data Bytes\n0000021A,FE 36 12 \n0000048C,00 \n18FEF100,\n",
         [(0, 0x21A, "fe3612"), (0, 0x48C, "00"), (0, 0x18FEF100 | EXTENDED_FLAG, "")]),
        ("Time (ms),CAN ID,DLC,D0,D1,D2\n1.5,0x123,2,11,22,\n2,7FFh,1,AB,,\n",
         [(1_500, 0x123, "1122"), (2_000, 0x7FF, "ab")]),
        ("time,addr,bus,data\n0.25,1A0,0,0xFE3612\n0.5,00000123,1,fe:36\n",
         [(250_000, 0x1A0, "fe3612"), (500_000, 0x123 | EXTENDED_FLAG, "fe36")]),
        ("Timestamp;Id (dec);Data (dec)\n0,5;291;254 54 18\n", [(500_000, 0x123, "fe3612")]),
        ('"Time","ID","Length","Data"\n"1.0","123x","2","FE,36"\n', [(1_000_000, 0x123 | EXTENDED_FLAG, "fe36")]),
        ("timestamp_us\tMessage ID\tRTR\tLEN\tB1\n7\t98FEF100\t0\t1\tFF\n8\t123\tRemote\t8\t\n",
         [(7, 0x18FEF100 | EXTENDED_FLAG, "ff"), (8, 0x123 | REMOTE_FLAG, "00" * 8)]),
        ("Time,ID,Data\n12:30:00.5,123,01,02,03\n", [(45_000_500_000, 0x123, "010203")]),
        ("Timestamp,ID,Data\n2026-01-31T00:00:00.5+01:00,123,01\n", [(1_769_814_000_500_000, 0x123, "01")]),
        (("title\nLine,Abs Time(Sec),Rel Time (Sec),Status,Er,Tx,Description,Network,Node,Arb ID,Remote,Xtd,B1,B2,B3\n"
         "2,2550.368293675,0.0038,67371008,F,F,HS CAN $119,HS CAN,,119,F,F,00,0D,8B,,,\n"),
         [(2_550_368_294, 0x119, "000d8b")]),
        (("title\n" + "".join(f"HS CAN {number},{number},500000,T\n" for number in range(60))
          + "Line,Abs Time(Sec),Rel Time (Sec),Status,Er,Tx,Description,Network,Node,Arb ID,Remote,Xtd,B1,B2,B3\n"
          + "".join(f"{n},0.{n}5,0.01,0,F,F,HS CAN $119,HS CAN,,119,F,F,00,0D,8B\n" for n in range(1, 9))),
         [(1000 * (100 * n + 50), 0x119, "000d8b") for n in range(1, 9)]),
        ("Time\tChannel\tFlags\tID\tDLC\tData\tParserFlags\n1\t1\t0\t123\t1\t01\t0\n", [(1, 0x123, "01")]),
    ],
)  # fmt: skip
def test_a_header_says_what_its_columns_are(text: str, expected: list[tuple[int, int, str]]) -> None:
    assert detect(text.encode()).format is LogFormat.COLUMNS
    batch, counts = read(ColumnsLog(), text)
    assert rows(batch) == expected
    assert counts.rejected == {}


@pytest.mark.parametrize(
    ("choice", "text"),
    [
        ("time=When,id=Who,data=What", "Who,Mood,When,What\n123,good,0.5,FE36\n"),
        ("time=when:s,id=WHO:hex,data=What:hex", "Who,Mood,When,What\n123,good,0.5,FE36\n"),
        ("time=T:ms,id=A,data=P0-P1", "A;P0;P1;T\n123;FE;36;500\n"),
        ("time=1:us,id=2,data=4-5", "500000 ; 123 ; x ; FE ; 36\n"),
        ("id=3,time=1:ms,data=4:dec", "500|x|0x123|254 54\n"),
    ],
)
def test_one_may_say_what_the_columns_are(choice: str, text: str) -> None:
    batch, counts = read(ColumnsLog(choice), text)
    assert rows(batch) == [(500_000, 0x123, "fe36")]
    assert counts.rejected == {}


@pytest.mark.parametrize(
    "line",
    ["1.0,123,2,01", "1.0,123,9,01", "x,123,1,01", "1.0,GHI,1,01", "1.0,123,1,1234x", "1.0,123", "1.0,FFFFFFFFF,0,"],
)
def test_damaged_lines_are_counted(line: str) -> None:
    text = f"Time [s],ID,DLC,Data\n0.5,123,1,01\n{line}\n"
    batch, counts = read(ColumnsLog(), text)
    is_short = line == "1.0,123"  # a frame without bytes, as far as one can tell
    assert (len(batch), sum(counts.rejected.values())) == ((2, 0) if is_short else (1, 1))


@pytest.mark.parametrize(
    "text",
    [
        "ID,Bytes,Note\n0x123,8,Engine speed\n0x124,8,Torque\n0x200,4,Gear\n",
        "ID;Name;Cycle time [ms];Data;Notes\n123;Engine;10;00 11;rpm\n124;Torque;10;00;Nm\n200;Gear;20;01;gear\n",
        "CAN ID,Message,Note\n0x7E0,AB,tester request\n0x7E8,EA,answer\n0x7E1,10 03,session\n0x7E9,50 03,session\n",
        "ID,Data,Notes\n0x7E0,,request\n0x7E8,,answer\n0x7E8,,answer again\n",
        "ID,Bytes\n0x123,8\n0x124,8\n0x200,4\n",
    ],
)
def test_a_list_of_identifiers_is_no_log(text: str) -> None:
    with pytest.raises(SourceError, match=r"^a list of identifiers, not a log: .*; if it is one, say --columns '?id="):
        detect(text.encode())


def table(head: str, *cells: tuple[str, str]) -> str:
    """Return a table of times, identifiers and bytes."""
    return head + "".join(f"{k * 0.01:.2f},{one},0,{data}\n" for k, (one, data) in enumerate(cells))


@pytest.mark.parametrize(
    ("text", "can_ids", "said"),
    [
        # Cabana and the first loggers of panda write decimal numbers, the later ones and libpanda as well.
        (table("time,addr,bus,data\n", ("53", "0acc"), ("344", "c0")), [53, 344], "decimal: its header is Cabana's"),
        (table("time,addr,bus,data\n", ("0x35", "0acc"), ("0x158", "c0")), [0x35, 0x158], ""),
        ("Bus,MessageID,Message\n0,344,c000\n1,53,00\n", [344, 53], "decimal: its header is Panda's"),
        ("Time,Bus,MessageID,Message,MessageLength\n1.5,1,344,c000,2\n1.6,0,53,00ff,2\n", [344, 53], "decimal"),
        # As hexadecimal 1349 would be no identifier of 11 bits, and too short for one of 29.
        (table("Time,ID,Bus,Data\n", ("53", "0a"), ("1349", "0b")), [53, 1349], "decimal: as hexadecimal 1349"),
        (table("Time,ID,Bus,Data\n", ("053", "0a"), ("130", "0b")), [0x53, 0x130], "hexadecimal: they have leading"),
        (table("Time,ID,Bus,Data\n", ("153", "0a"), ("130", "0b")), [0x153, 0x130], "hexadecimal: nothing shows"),
        # A letter decides where there are some of them, not one among many.
        (table("Time,ID,Bus,Data\n", ("53", "0a"), ("1A0", "0b")), [0x53, 0x1A0], ""),
        (table("Time,ID,Bus,Data\n", *((f"{k * 53}", "0a") for k in range(1, 36)), ("1A0", "0b")),
         [k * 53 for k in range(1, 36)], "decimal: 1 of 36 has letters"),
    ],
)  # fmt: skip
def test_the_base_of_identifiers_is_told_by_the_whole_column(text: str, can_ids: list[int], said: str) -> None:
    log = ColumnsLog()
    batch, _ = read(log, text)
    assert batch.can_id.tolist() == can_ids
    notes = [note for note in log.notes if note.startswith("identifiers are taken as")]
    assert len(notes) == bool(said)
    assert not said or notes[0].startswith(f"identifiers are taken as {said}")
