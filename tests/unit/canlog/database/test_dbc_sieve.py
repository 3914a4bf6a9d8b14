"""Items of a DBC file that cannot be right: each is found with its line, and nothing but it is left out."""

from typing import Final

import cantools
import pytest
from cantools.database.can import Database
from hypothesis import given, settings
from hypothesis import strategies as st

from canlog.database.dbc_sieve import Sieve

HEAD: Final = 'VERSION ""\n\nNS_ :\n\tNS_DESC_\n\tCM_\n\tVAL_\n\nBS_:\n\nBU_: A B\n'
LINE: Final = HEAD.count("\n") + 1  # of what follows the head


def signal(name: str, start: int, marker: str = "", tail: str = '"" A') -> str:
    return f" SG_ {name} {marker}: {start}|8@1+ (1,0) [0|0] {tail}\n"


MESSAGE: Final = "BO_ 256 M: 8 A\n" + signal("s", 0) + signal("t", 8)
MULTIPLEXED: Final = "BO_ 512 X: 8 A\n" + signal("p", 0, "M ") + signal("a", 8, "m0 ") + signal("b", 8, "m1 ")
SOUND: Final = MESSAGE + MULTIPLEXED + 'CM_ SG_ 256 s "text; // with \\"quotes\\"\nBO_";\nVAL_ 256 s 0 "a" 1 "b" ;\n'


def loaded(text: str) -> Database:
    database = cantools.database.load_string(text, "dbc", strict=False)
    assert isinstance(database, Database)
    return database


def names(text: str) -> dict[str, list[str]]:
    return {message.name: [one.name for one in message.signals] for message in loaded(text).messages}


def test_a_sound_text_stays_as_it_is() -> None:
    sieve = Sieve(HEAD + SOUND)
    assert sieve.offences == []
    assert sieve.text == HEAD + SOUND


@pytest.mark.parametrize(
    ("item", "cause"),
    [
        ('VAL_ 300 x 0 "a";', "there is no message 300"),
        ('VAL_ 256 x 0 "a";', "message M (256) has no signal x"),
        ('VAL_ 256 s 0.5 "a";', "its numbers must be whole"),
        ('VAL_ 256 s 3 "Second" 1', "is not of the form VAL_"),
        ('CM_ VAL_ 256 s 0 "a";', "is not of the form CM_"),
        ('VAL_ 256 s 0 "a ;', "the character '\"' belongs to no statement"),
        ("SIG_VALTYPE_ 300 x : 1;", "there is no message 300"),
        ("SIG_VALTYPE_ 256 s : 7;", "there is no type 7"),
        ("SG_MUL_VAL_ 512 a q 0-1;", "message X has no multiplexer q"),
        ("SG_MUL_VAL_ 512 a p 0 1;", "its ranges must be whole numbers"),
        ('BA_ "Undefined" BO_ 256 1;', "the attribute Undefined is not defined"),
        ('BA_REL_ "Undefined" BU_BO_REL_ A 256 1;', "the attribute Undefined is not defined"),
        ('BA_DEF_ BO_ "T" INT 0;', "its range has one end only"),
        ('BA_DEF_ SG_ "SPN" STRING ;', "cannot be of the kind STRING"),
        ('CM_ BO_ 2.5 "text";', "the identifier must be a whole number"),
        ("BO_TX_BU_ 2.5 : A;", "the identifier must be a whole number"),
        ("SGTYPE_ a: 8;", "is a statement that is not understood"),
        ("%%% anything", "the character '%' belongs to no statement"),
        ("anything else;", "belongs to no statement"),
        (' SG_ z : 24|8@1+ (1,0) [0|0] "" A', "it belongs to no message"),
    ],
)  # fmt: skip
def test_a_wrong_item_is_named_and_left_out_alone(item: str, cause: str) -> None:
    before, after = HEAD + SOUND, 'VAL_ 256 t 7 "seven";\n'
    sieve = Sieve(f"{before}{item}\n{after}")
    (offence,) = sieve.offences
    assert offence.line == before.count("\n") + 1
    assert offence.item.startswith(item.strip()[:20])
    assert cause in offence.cause
    assert names(sieve.text) == {"M": ["s", "t"], "X": ["p", "a", "b"]}
    message = loaded(sieve.text).get_message_by_name("M")
    assert (message.get_signal_by_name("s").choices, message.get_signal_by_name("t").choices) == (
        {0: "a", 1: "b"},
        {7: "seven"},
    )


@pytest.mark.parametrize(
    ("body", "causes", "left"),
    [
        (signal("4WD", 16), ["is not of the form SG_"], ["s"]),
        (' SG_ z : 16|8@1+ (x,0) [0|0] "" A\n', ["is not of the form SG_"], ["s"]),
        (' SG_ z : 16|0@1+ (1,0) [0|0] "" A\n', ["the length above 0"], ["s"]),
        (signal("s", 16), ["message N has another signal s"], ["s"]),
        (signal("z", 16, "x "), ["x is not a multiplexer's mark"], ["s"]),
        (signal("p", 8, "m ") + signal("a", 16, "m0 "), ["without its number", "has no multiplexer (M)"], ["s"]),
        (signal("a", 16, "m0 ") + signal("b", 24), ["has no multiplexer (M)"], ["s", "b"]),
        (signal("p", 8, "M ") + signal("q", 16, "M ") + signal("a", 24, "m0 "), ["which of p, q"], ["s", "p", "q"]),
    ],
)  # fmt: skip
def test_signals_that_cannot_be_told_are_left_out(body: str, causes: list[str], left: list[str]) -> None:
    sieve = Sieve(HEAD + "BO_ 257 N: 8 A\n" + signal("s", 0) + body + MESSAGE)
    assert all(cause in offence.cause for offence, cause in zip(sieve.offences, causes, strict=True))
    assert sieve.offences[0].line >= LINE + 2
    assert names(sieve.text) == {"N": left, "M": ["s", "t"]}


@pytest.mark.parametrize("head", ["BO_ 99999999999 N: 8 A", "BO_ 2.5 N: 8 A", "BO_ x N: 8 A", "BO_ 257 N 8 A"])
def test_a_message_takes_its_signals_along(head: str) -> None:
    sieve = Sieve(f"{HEAD}{head}\n{signal('z', 0)}{MESSAGE}")
    assert [offence.line for offence in sieve.offences] == [LINE, LINE + 1]
    assert names(sieve.text) == {"M": ["s", "t"]}


def test_a_float_of_no_float_length_is_left_out_rather_than_read_as_a_number() -> None:
    sieve = Sieve(HEAD + MESSAGE + "SIG_VALTYPE_ 256 s : 1;\n")
    assert "a float of 8 bits" in sieve.offences[0].cause
    assert names(sieve.text) == {"M": ["t"]}


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        (MESSAGE + 'VAL_ 256 s 0 "a"\nVAL_ 256 t 0 "b";\n', {"M": ["s", "t"]}),
        ("BO_ 256 M: 8\n" + signal("s", 0, tail='""'), {"M": ["s"]}),
        ("BO_ 256 M: 8 Gerät\n" + signal("Öl", 0, tail='"°C" Gerät') + 'VAL_ 256 Öl 0 "ä";\n', {"M": ["Oel"]}),
        ("BO_ 256 M: 8 A\n" + signal("Öl", 0) + signal("Oel", 8), {"M": ["Oel_", "Oel"]}),
        ("BO_ 256 M: 8 A\n" + signal("Temp_°C", 0), {"M": ["Temp_u00b0C"]}),
        ("BO_ 256 温度: 8 A\n" + signal("s", 0), {"u6e29u5ea6": ["s"]}),
    ],
)
def test_what_can_be_mended_is_mended_and_said(text: str, wanted: dict[str, list[str]]) -> None:
    sieve = Sieve(HEAD + text)
    assert sieve.offences
    assert all(offence.is_mended for offence in sieve.offences)
    assert names(sieve.text) == wanted
    first = loaded(sieve.text).messages[0].signals[0]
    assert first.choices in (None, {0: "a"}, {0: "ä"})


PIECES: Final = st.sampled_from(
    [*SOUND.split(), *HEAD.split(), "\n", "\n", '"', ";", "SG_", "BO_", "m", "m0", "ü", "%", "1-2", "256", "\x00"]
)


@given(st.lists(PIECES, max_size=60), st.integers(0, len(SOUND)))
@settings(deadline=None)
def test_whatever_is_left_of_a_damaged_text_loads(pieces: list[str], at: int) -> None:
    sieve = Sieve(f"{HEAD}{SOUND[:at]} {' '.join(pieces)} \n{SOUND[at:]}\nBO_ 1 Last: 8 A\n{signal('z', 0)}")
    assert "Last" in names(sieve.text)
    assert not [offence for offence in Sieve(sieve.text).offences if not offence.is_harmless]
