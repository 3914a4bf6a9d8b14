"""Trouble codes: addresses, states, and what is cleared."""

import pytest

from diag_service.errors import ConfigError
from workshop.tester.addresses import CanAddress, parse_address, usual_response_id
from workshop.tester.answers import belongs, fault
from workshop.tester.description import CodeDescription, CodedType, Datum, Description, Field
from workshop.tester.questions import parse_group
from workshop.tester.trouble import TroubleCode, read_codes

SPEED = Field(name="speed", kind=CodedType.UNSIGNED, size_bytes=2, unit="km/h", resolution=0.01, invalid=0xFFFF)
KNOWN = Description(
    name="known",
    data={0x0102: Datum(number=0x0102, name="vehicle speed", fields=(SPEED,))},
    extended={
        0x01: Datum(number=1, name="counter", fields=(Field(name="times", kind=CodedType.UNSIGNED, size_bytes=1),)),
        0x10: Datum(number=16, name="at the failure", fields=(SPEED,)),
    },
    troubles=(
        CodeDescription(code="P0811", text="slips"),
        CodeDescription(code="P0811", text="slips too much", failure_type=0x07),
        CodeDescription(code="U3FFF", text="bus", failure_type=0x00),
    ),
)


def test_codes_have_text_and_states() -> None:
    codes = read_codes(bytes.fromhex("59 02 FF 081107 2F 081100 08 FFFF00 04 000000 00"), KNOWN)
    assert [(one.code, one.failure_type, one.text) for one in codes] == [
        ("P0811", 0x07, "slips too much"),
        ("P0811", 0x00, "slips"),
        ("U3FFF", 0x00, "bus"),
    ]
    assert codes[0].states == ("failed", "failed this cycle", "pending", "confirmed", "failed since clear")
    assert [(one.is_pending, one.is_confirmed) for one in codes] == [(False, True), (False, True), (True, False)]


@pytest.mark.parametrize(
    ("request_hex", "response_hex", "text"),
    [
        ("19 02 AF", "59 02", "at least 3 bytes are due, and it has 2"),
        ("19 02 AF", "59 02 FF 08 11", "its last trouble code is cut off"),
        ("19 02 AF", "59 02 FF 081107 2F 0897", "its last trouble code is cut off"),
        ("19 02 AF", "59 02 FF 000000 2F", "it names the trouble code 000000, which is none"),
        ("19 0A", "59 0A FF 081107 2F 081107 08", "it names a trouble code twice"),
        ("19 02 AF", "59 02 10", "the controller keeps none of the status bits that were asked for, only 10"),
        ("19 01 AF", "59 01 FF 42 0001", "its trouble codes have the unknown format 42"),
        ("19 01 AF", "59 01 FF 01 0001 00", "6 bytes are due, and it has 7"),
        ("19 04 081107 FF", "59 04 081100 2F", "it is about 08 11 00, not about 08 11 07"),
        ("19 06 081107 91", "59 06 081107", "at least 6 bytes are due, and it has 5"),
        ("10 03", "50 03 00", "6 bytes are due, and it has 3"),
        ("14 FFFFFF", "54 00", "1 byte is due, and it has 2"),
        ("22 F190", "62 F190", "at least 4 bytes are due, and it has 3"),
        ("22 F190", "62 F190 41 62 F190 41", "it holds the same answer twice"),
        ("27 01", "67 01", "at least 3 bytes are due, and it has 2"),
        ("27 02 1234", "67 02 00", "2 bytes are due, and it has 3"),
        ("31 01 0301", "71 01 03", "at least 4 bytes are due, and it has 3"),
        ("3E 00", "7E 00 00", "2 bytes are due, and it has 3"),
        ("22 F190", "7F 22 31 00", "3 bytes are due, and it has 4"),
        ("22 F190", "7F 22 00", "it is negative and gives no reason"),
        ("19 02 AF", "59 02 FF", ""),
        ("19 02 AF", "59 02 FF 081107 2F 000000 00", ""),
        ("31 01 0301", "71 01 0301", ""),
        ("10 03", "50 03", ""),  # the edition of 2006
    ],
)
def test_what_breaks_the_rules_is_named(request_hex: str, response_hex: str, text: str) -> None:
    assert fault(bytes.fromhex(request_hex), bytes.fromhex(response_hex)) == text


def test_an_answer_belongs_to_its_request_only() -> None:
    def fits(request: str, response: str) -> bool:
        return belongs(bytes.fromhex(request), bytes.fromhex(response))

    assert fits("22 F190", "62 F190 00")
    assert not fits("22 F190", "62 F187 00")
    assert fits("22 F190", "7F 22 31")
    assert not fits("22 F190", "7F 19 31")
    assert not fits("22 F190", "")
    assert not fits("22 F190", "7F 22")
    assert fits("3E 80", "7E 00")
    assert fits("31 01 0301 05", "71 01 0301 00")
    assert not fits("31 01 0301", "71 01 0302 00")
    assert not fits("19 02 FF", "59 04 FF")


CODES = tuple(TroubleCode(number=number, status=0x0F) for number in (0x081107, 0x081109, 0x02184B, 0xC07300))


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("all", (0xFFFFFF,)),
        ("ALL", (0xFFFFFF,)),
        ("obd", (0xFFFF33,)),
        ("P0811", (0x081107, 0x081109)),
        ("p0811-09", (0x081109,)),
        ("P2787-4B", (0x27874B,)),  # whether it is there or not
        ("U0073", (0xC07300,)),
        ("0x02184b", (0x02184B,)),
    ],
)
def test_a_word_names_a_group(text: str, numbers: tuple[int, ...]) -> None:
    assert parse_group(text).numbers(CODES) == numbers


def test_a_code_that_is_not_there_is_not_cleared_by_guess() -> None:
    with pytest.raises(ConfigError, match=r"^P0897 is not among .* reports: P0811, P0218, U0073$"):
        parse_group("P0897").numbers(CODES)


@pytest.mark.parametrize("text", ["", "P081", "P4811", "X0811", "P0811-7", "P0811-", "08110", "0811077", "some"])
def test_what_names_no_group_is_refused(text: str) -> None:
    with pytest.raises(ConfigError, match="--clear must be all, obd, a code"):
        parse_group(text)


@pytest.mark.parametrize(
    ("request_id", "response_id"), [(0x7E1, 0x7E9), (0x700, 0x708), (0x18DA10F1, 0x18DAF110), (0x18DAFFF1, 0x18DAF1FF)]
)
def test_the_rules_of_the_standard_give_the_answer(request_id: int, response_id: int) -> None:
    assert usual_response_id(request_id) == response_id


def test_words_become_an_address() -> None:
    assert parse_address(None, None) is None
    assert parse_address("7e0", None) == CanAddress(request_id=0x7E0, response_id=0x7E8)
    assert parse_address("0x6F1", "612", "12") == CanAddress(request_id=0x6F1, response_id=0x612, target_byte=0x12)
    assert str(parse_address("7e0", None)) == "7E0 (answers 7E8)"


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        ((None, "7E8"), "need --ecu"),
        (("7G0", None), "--ecu must be hexadecimal, 0 to 1FFFFFFF, got '7G0'"),
        (("20000000", "1"), "--ecu must be hexadecimal"),
        (("7E0", "18DAF110"), "both have 11 bits or both 29"),
        (("7DF", None), "--reply is needed: 7DF asks all controllers"),
        (("7E0", "7E0"), "the same identifier 7E0"),
        (("7E0", None, "100"), "--address must be hexadecimal, 0 to FF, got '100'"),
    ],
)
def test_words_that_are_none_are_named(words: tuple[str | None, ...], complaint: str) -> None:
    with pytest.raises(ConfigError, match=complaint):
        parse_address(*words)
