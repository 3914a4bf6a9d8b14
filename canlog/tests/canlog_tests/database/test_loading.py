"""Databases of other people: one bad line costs one line, which is told; what is none is refused without harm."""

import logging
from pathlib import Path
from typing import Final

import cantools
import numpy as np
import numpy.typing as npt
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


OTHER = 'BO_ 512 N: 8 A\n SG_ t : 8|8@1+ (2,-1) [0|0] "" A\n'
UNMARKED: Final = (
    'BO_ 419361278 W: 8 A\n SG_ w : 0|8@1+ (1,0) [0|0] "" A\nCM_ SG_ 419361278 w "w";\nVAL_ 419361278 w 1 "a";\n'
)
PAYLOADS: Final = np.random.default_rng(3).integers(0, 256, (50, 8)).astype(np.uint8)


def loaded(path: Path, caplog: pytest.LogCaptureFixture) -> tuple[dict[str, set[str]], list[str]]:
    """Return the signals of each message of a database, and what was told of its lines."""
    caplog.clear()
    with caplog.at_level(logging.WARNING, logger="canlog"):
        database = load_database(path)
    signals = {message.name: {signal.name for signal in message.signals} for message in database.messages}
    return signals, [record.getMessage().removeprefix(f"{path}: ") for record in caplog.records]


@pytest.mark.parametrize(
    ("items", "signals", "cause"),
    [
        (' SG_ u : 8|8@1+ (x,0) [0|0] "" A\n', {"s"}, "line 5: invalid syntax at column 18"),
        (' SG_ 0_u : 8|8@1+ (1,0) [0|0] "" A\n', {"s"}, "line 5: invalid syntax at column 6"),
        (' SG_ u : 8|8@1+ (1,0) [0|0] "rpm A\n', {"s"}, "line 5: invalid syntax"),
        (' SG_ u : 8|0@1+ (1,0) [0|0] "" A\n', {"s"}, "line 5: signal u: 8|0 is no place"),
        (' SG_ u : 8|8@5+ (1,0) [0|0] "" A\n', {"s"}, "line 5: signal u: there is no byte order 5"),
        (' SG_ u : 8|4000000000@1+ (1,0) [0|0] "" A\n', {"s"}, "line 5: 8|4000000000@: no CAN message is so long"),
        (' SG_ s : 8|8@1+ (1,0) [0|0] "" A\n', set(), "line 4: message M has another signal s"),
        (' SG_ p m : 8|8@1+ (1,0) [0|0] "" A\n', {"s"}, "line 5: signal p: m is not a multiplexer's mark"),
        (' SG_ a m0 : 8|8@1+ (1,0) [0|0] "" A\n', {"s"}, "line 5: signal a: nothing says which multiplexer (M)"),
        (
            "".join(
                f' SG_ {mark} : {8 * k}|8@1+ (1,0) [0|0] "" A\n' for k, mark in enumerate(("p M", "q M", "a m0"), 1)
            ),
            {"s", "p", "q"},
            "line 7: signal a: nothing says which multiplexer (M)",
        ),
        (
            ' SG_ p M : 8|8@1+ (x,0) [0|0] "" A\n SG_ a m0 : 24|8@1+ (1,0) [0|0] "" A\n',
            {"s"},
            "line 6: signal a: its multiplexer p is left out",
        ),
        (
            ' SG_ p M : 8|8@1+ (1,0) [0|0] "" A\n SG_ a m0 : 24|8@1+ (1,0) [0|0] "" A\nSG_MUL_VAL_ 256 a q 0-1;\n',
            {"s", "p"},
            "line 6: SG_MUL_VAL_ of a: its message has no multiplexer q",
        ),
        ("SIG_VALTYPE_ 256 s : 1;\n", set(), "line 4: signal s of message M is a float of 8 bits"),
        ("SIG_VALTYPE_ 256 s : 7;\n", set(), "line 4: signal s: SIG_VALTYPE_ has no type 7"),
        ("SIG_VALTYPE_ 256 u : 1;\n", {"s"}, "line 5: SIG_VALTYPE_ 256 u names no signal"),
        ('VAL_ 256 u 0 "a" ;\n', {"s"}, "line 5: VAL_ 256 u names no signal"),
        ('CM_ SG_ 256 "no name";\n', {"s"}, "line 5: invalid syntax at column 13"),
        ('CM_ BO_ 256 "no end\n', {"s"}, "line 5: "),
        ('CM_ "no semicolon"\n', {"s"}, "line 5: the statement breaks off"),
        ('BA_ "Undefined" BO_ 256 1;\n', {"s"}, "line 5: attribute 'Undefined' is not defined"),
        ('BA_DEF_ BO_ "T" INT 0 10;\nBA_ "T" BO_ 256 abc;\n', {"s"}, "line 6: invalid syntax at column 17"),
        ('BA_DEF_ BO_ "T" INT 0 10;\nBA_ "T" BO_ 256 "abc";\n', {"s"}, "line 6: attribute 'T': \"abc\" is no number"),
        ('BO_ 3000000000 P: 8 A\n SG_ p : 0|8@1+ (1,0) [0|0] "" A\n', {"s"}, "line 5: message P: no CAN identifier is"),
        (
            'BO_ 99999999999 P: 8 A\n SG_ p : 0|8@1+ (1,0) [0|0] "" A\n',
            {"s"},
            "line 5: message P: no CAN identifier is",
        ),
        (
            'BO_ 700 P: 4000000 A\n SG_ p : 0|8@1+ (1,0) [0|0] "" A\n',
            {"s"},
            "line 5: BO_ 700 P: 4000000: no CAN message",
        ),
        ('BO_ 700 0_P: 8 A\n SG_ p : 0|8@1+ (1,0) [0|0] "" A\n', {"s"}, "line 5: invalid syntax at column 9"),
        ('B0_ 700 P: 8 A\n SG_ p : 0|8@1+ (1,0) [0|0] "" A\n', {"s"}, "line 5: not a statement of a DBC file"),
        ('CM_ "x";\n SG_ p : 0|8@1+ (1,0) [0|0] "" A\n', {"s"}, "line 6: a signal stands behind no message"),
    ],
)
def test_one_bad_line_costs_one_line(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, items: str, signals: set[str], cause: str
) -> None:
    read, told = loaded(write(tmp_path, HEAD + SIGNAL + items + OTHER), caplog)
    assert read == {"M": signals, "N": {"t"}}
    assert any(text.startswith(cause) and text.endswith("(left out)") for text in told), told


def values(path: Path) -> dict[str, npt.NDArray[np.float64]]:
    """Return what every signal has in random payloads."""
    decoded = dict[str, npt.NDArray[np.float64]]()
    for message in load_database(path).messages:
        can_id = message.frame_id | (EXTENDED_FLAG if message.is_extended_frame else 0)
        (found,) = Codec([message], check_range=False).decode(frames_at(np.arange(50), can_id, data=PAYLOADS))
        decoded |= {f"{can_id} {message.name}.{name}": signal.value for name, signal in found.signals.items()}
    return decoded


@pytest.mark.parametrize(
    ("odd", "mended", "cause"),
    [
        (
            UNMARKED,
            UNMARKED.replace("419361278", "2566844926"),
            "line 7: message W: identifier 419361278 lacks the mark of 29 bits",
        ),
        (
            "".join(
                f' SG_ {mark} : {k}|8@1+ (3,1) [0|0] "" A\n' for k, mark in ((16, "c m"), (24, "a m0"), (32, "b m1"))
            ),
            "".join(
                f' SG_ {mark} : {k}|8@1+ (3,1) [0|0] "" A\n' for k, mark in ((16, "c M"), (24, "a m0"), (32, "b m1"))
            ),
            "line 7: signal c: its mark m is read as M",
        ),
        (
            ' SG_ u : 8|8@1+ (.25,-5) [0|0] "" A\n SG_ v : 24|8@1+ (1,0) [0|0] "" A\n',
            ' SG_ v : 24|8@1+ (1,0) [0|0] "" A\n',
            "line 7: invalid syntax at column 18",
        ),
    ],
)
def test_values_are_those_of_the_file_mended_by_hand(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, odd: str, mended: str, cause: str
) -> None:
    by_hand = tmp_path / "mended.dbc"
    by_hand.write_text(HEAD + SIGNAL + OTHER + mended)
    strict = cantools.database.load_file(by_hand, strict=False)
    assert isinstance(strict, Database)
    path = write(tmp_path, HEAD + SIGNAL + OTHER + odd)
    _, told = loaded(path, caplog)
    assert len(told) == 1
    assert told[0].startswith(cause), told
    found, wanted = values(path), values(by_hand)
    assert found.keys() == wanted.keys()
    assert all(same_bits(found[name], wanted[name]) for name in wanted)
    for message in strict.messages:
        number = message.frame_id | (EXTENDED_FLAG if message.is_extended_frame else 0)
        for name, value in reference(message, [row.tobytes() for row in PAYLOADS]).items():
            is_there = ~np.isnan(value)
            assert same_bits(found[f"{number} {message.name}.{name}"][is_there], value[is_there])


def test_a_file_is_read_with_those_that_it_imports(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    (tmp_path / "common.dbc").write_text(HEAD + SIGNAL + ' SG_ u : 8|8@1+ (x,0) [0|0] "" A\n')
    imports = "".join(f'CM_ "IMPORT {name}";\n' for name in ("common.dbc", "missing.dbc", "../common.dbc", "some.dbc"))
    read, told = loaded(write(tmp_path, imports + OTHER + 'VAL_ 256 s 1 "a";\n'), caplog)
    assert read == {"N": {"t"}, "M": {"s"}}
    assert [text.split(" ", 3)[:3] for text in told] == [
        ["line", "2:", "missing.dbc"],
        ["line", "3:", "../common.dbc"],
        ["common.dbc,", "line", "5:"],
    ]


@pytest.mark.parametrize(
    ("text", "place"),
    [
        (HEAD + 'BO_ 256 M: 8 A\n SG_ s : 0|8@1+ (x,0) [0|0] "" A\n', "1 of 1 messages can be read; line 4: "),
        (HEAD + 'BO_ 99999999999 M: 8 A\n SG_ s : 0|8@1+ (1,0) [0|0] "" A\n', "0 of 1 messages can be read; line 3: "),
        (HEAD + 2 * "BO_ 3000000000 M: 8 A\n" + SIGNAL, "1 of 3 messages can be read; line 3: "),
        ("Notes on the gearbox\n\nBuy oil.\n", "Invalid syntax at line 3"),
    ],
)
def test_a_file_of_which_next_to_nothing_can_be_read_is_refused(tmp_path: Path, text: str, place: str) -> None:
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
        (
            HEAD + 'BO_ 1 m: 8 A\n SG_ s m0-4294967295 : 8|8@1+ (1,0) [0|0] "" A\n',
            "line 4: invalid syntax at column 10",
        ),
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
