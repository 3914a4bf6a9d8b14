"""Where a controller is asked, and where its answers come from."""

import pytest

from diag_service.errors import ConfigError
from diag_service.tester.addresses import CanAddress, parse_address, usual_response_id


@pytest.mark.parametrize(
    ("request_id", "response_id"),
    [(0x7E1, 0x7E9), (0x700, 0x708), (0x18DA10F1, 0x18DAF110), (0x18DAFFF1, 0x18DAF1FF)],
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
