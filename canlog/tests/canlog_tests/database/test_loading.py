"""Databases of other people: good ones load, bad ones are refused with one clear line and without harm."""

import logging
from pathlib import Path
from typing import Final

import cantools
import numpy as np
import pytest
from cantools.database.can import Database

from canlog.database.loading import load_database
from canlog.decode.codec import Codec
from canlog.errors import DefinitionError
from canlog.frames import EXTENDED_FLAG
from tests.support.batches import frames_at
from tests.support.cantools_oracle import reference, same_bits
from tests.support.wire import DATABASE

DATA: Final = Path(__file__).parents[4] / "tests" / "data"

HEAD = 'VERSION ""\nBU_: A\n'
SIGNAL = 'BO_ 256 M: 8 A\n SG_ s : 0|8@1+ (1,0) [0|0] "" A\n'


def write(folder: Path, text: str | bytes) -> Path:
    path = folder / "some.dbc"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def refusal(path: Path) -> str:
    with pytest.raises(DefinitionError) as refused:
        load_database(path)
    text = str(refused.value)
    assert "\n" not in text
    assert len(text) < 400
    return text


def test_every_message_that_breaks_strict_rules_is_named(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    messages = "".join(
        f'BO_ {256 + k} M{k}: 8 A\n SG_ s : 0|8@1+ (1,0) [0|0] "" A\n SG_ t : {(4, 60)[k % 2]}|8@1+ (1,0) [0|0] "" A\n'
        for k in range(30)
    )
    with caplog.at_level(logging.WARNING, logger="canlog"):
        load_database(write(tmp_path, HEAD + messages))
    said = [record.getMessage() for record in caplog.records]
    assert len(said) == 21
    assert "overlapping in message M0." in said[0]
    assert "does not fit in message M1." in said[1]
    assert "and 10 more like these" in said[-1]


@pytest.mark.parametrize(
    ("items", "cause"),
    [
        (' SG_ s : 8|8@1+ (1,0) [0|0] "" A\n', "message M has another signal s"),
        (' SG_ p m : 8|8@1+ (1,0) [0|0] "" A\n', "line 5: signal p: m is not a multiplexer's mark"),
        (' SG_ a m0 : 8|8@1+ (1,0) [0|0] "" A\n', "line 5: signal a: nothing says which multiplexer (M)"),
        (
            "".join(f' SG_ {one} : {8 * k}|8@1+ (1,0) [0|0] "" A\n' for k, one in enumerate(("p M", "q M", "a m0"), 1)),
            "line 7: signal a: nothing says which multiplexer (M)",
        ),
        (
            ' SG_ p M : 8|8@1+ (1,0) [0|0] "" A\n SG_ a m0 : 24|8@1+ (1,0) [0|0] "" A\nSG_MUL_VAL_ 256 a q 0-1;\n',
            "line 7: SG_MUL_VAL_ of a: its message has no multiplexer q",
        ),
        ("SIG_VALTYPE_ 256 s : 1;\n", "signal s of message M is a float of 8 bits"),
        ("SIG_VALTYPE_ 256 s : 7;\n", "line 5: SIG_VALTYPE_ 256: there is no type 7"),
    ],
)
def test_what_would_be_misread_is_refused_by_name(tmp_path: Path, items: str, cause: str) -> None:
    assert f"some.dbc would be misread: {cause}" in refusal(write(tmp_path, HEAD + SIGNAL + items))


@pytest.mark.parametrize(
    ("text", "place"),
    [
        (HEAD + 'BO_ 256 M: 8 A\n SG_ s : 0|8@1+ (x,0) [0|0] "" A\n', "Invalid syntax at line 4, column"),
        (HEAD + SIGNAL + 'BA_ "Undefined" BO_ 256 1;\n', "line 5: 'Undefined' is not defined"),
        (HEAD + SIGNAL + 'BA_DEF_ BO_ "T" INT 0 10;\nBA_ "T" BO_ 256 abc;\n', "Invalid syntax at line 6, column 17"),
        (HEAD + 'BO_ 99999999999 M: 8 A\n SG_ s : 0|8@1+ (1,0) [0|0] "" A\n', "line 3: Standard frame id"),
        (
            HEAD + 'BO_ 256 M: 8 A\n SG_ s : 0|0@1+ (1,0) [0|0] "" A\n',
            "line 3: The signal s length 0 is not greater than 0",
        ),
    ],
)
def test_damaged_database_is_refused_with_line_and_cause(tmp_path: Path, text: str, place: str) -> None:
    assert f"some.dbc is not a DBC file: {place}" in refusal(write(tmp_path, text))


def xml(body: str, head: str = "") -> str:
    return f'<?xml version="1.0"?>{head}<NetworkDefinition xmlns="http://kayak.2codeornot2code.org/1.0">{body}'


def kcd(message: str, signal: str) -> str:
    message = f'<Message id="0x1" name="m" {message}><Signal name="s" {signal}/></Message>'
    return xml(f'<Document/><Bus name="b">{message}</Bus></NetworkDefinition>')


def sym(lines: str) -> str:
    return f'FormatVersion=6.0 // x\nTitle="x"\n\n{{SENDRECEIVE}}\n\n[m]\nID=100h\n{lines}\n'


ENTITIES: Final = '<!DOCTYPE a [<!ENTITY b "bbbbbbbb"><!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;">]>'


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        (HEAD + 'BO_ 1 m: 8 A\n SG_ s m0-4294967295 : 8|8@1+ (1,0) [0|0] "" A\n', "Invalid syntax at line 4"),
        (kcd('length="4000000000"', 'offset="0" length="8"'), "no CAN message is so long"),
        (kcd('length="auto"', 'offset="4000000000" length="8"'), "no CAN message is so long"),
        (xml("<a>" * 300_000), "not a KCD file"),
        (xml("<Bus/></NetworkDefinition>"), "not a KCD file"),
        (xml("&c;</NetworkDefinition>", ENTITIES), "defines a document type or entities"),
        (xml("</NetworkDefinition>", '<!DOCTYPE a SYSTEM "file:///etc/passwd">'), "defines a document type"),
        ('<?xml version="1.0"?><AUTOSAR xmlns="http://autosar.org/schema/r4.0"/>', "not an ARXML file"),
        ("<html><body/></html>", "neither a DBC file nor a KCD or ARXML"),
        (sym("Len=8\nVar=s unsigned 0,4000000000"), "no CAN message is so long"),
        ("FormatVersion=6.0\n[[m]\n", "not a SYM file"),
    ],
)
def test_hostile_database_is_refused_within_the_limits(tmp_path: Path, text: str, complaint: str) -> None:
    assert complaint in refusal(write(tmp_path, text))


ARXML: Final = (DATA / "engine.arxml").read_text()


def as_kcd() -> str:
    corners = cantools.database.load_file(DATA / "corners.dbc")
    assert isinstance(corners, Database)
    return corners.as_kcd_string()


@pytest.mark.parametrize(
    ("text", "name", "count"),
    [
        (as_kcd(), "Multiplexed", 11),
        (DATABASE.as_sym_string(), "TCU_Pressures", 12),
        ((DATA / "engine.arxml").read_text(), "Engine", 1),
        ((DATA / "corners.dbc").read_text(), "SignedBig", 11),
    ],
    ids=["kcd", "sym", "arxml", "dbc"],
)
def test_every_format_decodes_to_the_bits_of_cantools(tmp_path: Path, text: str, name: str, count: int) -> None:
    database = load_database(write(tmp_path, text))
    assert len(database.messages) == count
    message = database.get_message_by_name(name)
    data = np.random.default_rng(3).integers(0, 256, (50, 8)).astype(np.uint8)
    can_id = message.frame_id | (EXTENDED_FLAG if message.is_extended_frame else 0)
    batch = frames_at(np.arange(50), can_id, data=data)
    (found,) = Codec([message], check_range=False).decode(batch)
    wanted = reference(message, [row.tobytes() for row in data])
    for signal, decoded in found.signals.items():
        is_there = ~np.isnan(wanted[signal])
        assert same_bits(decoded.value[is_there], wanted[signal][is_there])
