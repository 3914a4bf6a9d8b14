"""Tables of messages: their file names and the rows of long messages."""

from pathlib import PureWindowsPath

from cantools.database import load_string
from cantools.database.can import Database

from canlog.decode.codec import Codec, FrameFate
from canlog.tables.frame_groups import LongRows
from canlog.tables.table_folder import LONGEST_BYTES, file_names
from tests.support.transport_traffic import Sent, batch_of

ODD = (
    "Brake",
    "BRAKE",
    "a/b",
    "a:b",
    "..",
    "",
    "con",
    "Lpt1.old",
    "a b*?",
    "Getriebeöl",
    "x" * 300,
    "ö" * 300,
    "\ud800",
)


def test_every_name_is_one_of_a_file_and_of_one_only() -> None:
    names = file_names(ODD)
    assert len({name.casefold() for name in names}) == len(ODD)
    assert (names[0], names[1], names[9]) == ("Brake", "BRAKE-2", "Getriebeöl")
    for name in names:
        assert not set(name) & set('/\\:*?"<>| \0')
        assert 0 < len(name.encode()) <= LONGEST_BYTES + 4
        assert not PureWindowsPath(name).is_reserved()
        assert not name.startswith(".")
        assert name.isprintable()


FAST, SINGLE, ANSWER = 0x89F80501, 0x98FECA03, 0x7E8
DBC = """VERSION ""
BU_: A
BO_ 2314733054 Position: 43 A
 SG_ Number : 0|16@1+ (1,0) [0|0] "" A
 SG_ Far : 56|64@1- (1,0) [0|0] "" A

BO_ 2566834942 Trouble: 14 A
 SG_ Lamps : 0|16@1+ (1,0) [0|0] "" A
 SG_ Last : 96|16@1+ (0.5,-10) [0|0] "km" A

BO_ 2024 Answer: 30 A
 SG_ Service : 0|8@1+ (1,0) [0|0] "" A
 SG_ End : 200|8@1+ (1,0) [0|0] "" A

BA_DEF_ BO_ "VFrameFormat" ENUM "StandardCAN","ExtendedCAN","reserved","J1939PG";
BA_DEF_DEF_ "VFrameFormat" "StandardCAN";
BA_ "VFrameFormat" BO_ 2566834942 3;
BA_ "VFrameFormat" BO_ 2314733054 3;
"""


def rows_of(*frames: tuple[int, str]) -> tuple[dict[str, int], dict[str, int], dict[FrameFate, int], int]:
    """Return which values are in rows of long messages and cut off from them, frames by fate, incomplete."""
    database = load_string(DBC, "dbc")
    assert isinstance(database, Database)
    codec = Codec(database.messages, has_long=True)
    together = LongRows(codec)
    sent = [Sent(t_ns=n * 1_000_000, can_id=id_, data=bytes.fromhex(d), message=n) for n, (id_, d) in enumerate(frames)]
    values, cut_off, fates = dict[str, int](), dict[str, int](), dict[FrameFate, int]()
    for group in together.groups([batch_of(sent)]):
        for one in group.values(codec) + ([*group.long.values(codec)] if group.long else []):
            values |= {name: int(decoded.value[0]) for name, decoded in one.signals.items()}
            cut_off |= one.cut_off
        fates |= {fate: int(count) for fate in FrameFate if (count := group.match.counts[:, fate].sum())}
    return values, cut_off, fates, together.counts.incomplete_count


def test_frames_of_a_longer_group_in_data_page_1_are_pieces_that_nothing_puts_together() -> None:
    for frames in ([(FAST, "0006070003040506")], [(FAST, "0008070003040506"), (FAST, "010708FFFFFFFFFF")]):
        assert rows_of(*frames) == ({}, {}, {FrameFate.TRANSPORTED: len(frames)}, 0)


def test_an_answer_in_a_single_frame_is_a_row_of_what_it_has() -> None:
    assert rows_of((ANSWER, "037F221100000000")) == ({"Service": 0x7F}, {"End": 1}, {FrameFate.TRANSPORTED: 1}, 0)


def test_a_frame_of_a_group_in_data_page_0_is_a_short_message() -> None:
    assert rows_of((SINGLE, "0004010203040506")) == ({"Lamps": 0x400}, {"Last": 1}, {FrameFate.SHORT: 1}, 0)
