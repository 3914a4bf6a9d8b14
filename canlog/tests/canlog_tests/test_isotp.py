"""Which frames of ISO-TP make a message, and which make none."""

import pytest

from canlog.isotp import Reassembler
from tests.support.transport_traffic import MS, PAIRS, Sent, batch_of


def messages_in(*lines: tuple[int, int, str]) -> list[str]:
    sent = [Sent(t_ns=t_ms * MS, can_id=can_id, data=bytes.fromhex(data), message=-1) for t_ms, can_id, data in lines]
    return [one.data.hex() for one in Reassembler([*PAIRS, (0x7E1, 0x7E9)]).feed(batch_of(sent))]


FIRST, NEXT = (0, 0x7E8, "1009620102030405"), (9, 0x7E8, "21060708")


@pytest.mark.parametrize(
    "lines",
    [
        [FIRST, (5, 0x7E8, "2206070809101112")],  # the number of another frame
        [FIRST, (1500, 0x7E8, "2106070809101112")],  # too late
        [FIRST, (5, 0x7E0, "3200000000000000"), NEXT],  # the other side cannot take so much
        [FIRST, (2, 0x7E0, "3000"), (5, 0x7E0, "3000"), NEXT],  # flow control for another message
        [FIRST, (5, 0x7E8, "2106")],  # cut
        [FIRST],
        [(0, 0x7E8, "1004620102030405"), NEXT],  # would fit into a single frame
        [(0, 0x7E8, "0862010203040506")],  # longer than its frame
        [NEXT],
    ],
)
def test_a_message_of_which_something_is_missing_is_left_out(lines: list[tuple[int, int, str]]) -> None:
    assert messages_in(*lines) == []


def test_a_message_is_put_together_over_what_does_not_interrupt_it() -> None:
    assert messages_in(
        FIRST, (1, 0x7E9, "100A720102030405"), (2, 0x7E0, "3101"), (3, 0x7E0, "3000"), (4, 0x7E0, "023E000000000000"),
        NEXT, (9, 0x7E9, "2116171819000000"),
    ) == ["3e00", "620102030405060708", "72010203040516171819"]  # fmt: skip


def test_who_asks_again_waits_for_no_answer_any_more() -> None:
    assert messages_in(FIRST, (5, 0x7E0, "0322F19000000000"), NEXT) == ["22f190"]
