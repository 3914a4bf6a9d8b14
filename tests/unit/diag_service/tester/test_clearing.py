"""Which trouble codes are meant by a word of the command line."""

import pytest

from diag_service.errors import ConfigError
from diag_service.tester.questions import parse_group
from diag_service.tester.trouble import TroubleCode

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
