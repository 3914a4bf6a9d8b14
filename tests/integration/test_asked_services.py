"""The plugin that counts what asking sends: it sees what the product sends, fails for other services, and is used."""

import re
from pathlib import Path

import can
import pytest

from tests.plugins.asked_services import SentByUs

ASKS = re.compile(r'SignalAsker\(|asks=True|ended\("try"|"--active", "--adapter"')


def frame(text: str, can_id: int = 0x7E1) -> can.Message:
    return can.Message(arbitration_id=can_id, is_extended_id=can_id > 0x7FF, data=bytes.fromhex(text))


@pytest.mark.asks
def test_what_the_product_sends_is_seen_and_nothing_else(sent_by_us: SentByUs) -> None:
    with can.Bus("counted", "virtual") as bus:
        bus.send(frame("02 10 03"))
        exec("bus.send(one)", {"__name__": "diag_service.any", "bus": bus, "one": frame("03 22 38 EB")})  # noqa: S102
        exec("bus.send(one)", {"__name__": "diag_service.any", "bus": bus, "one": frame("30 00 00")})  # noqa: S102
    assert sent_by_us.services == {0x22: 1}
    assert sent_by_us.byte_count == 7


OTHERS = ("02 10 03", "10 0A 2E 38 EB 01 02 03", "00 09 31 01 02 03 04 05 06 07 08", "06 2C 01 F3 00 38 EB")


@pytest.mark.parametrize("request_", OTHERS)
def test_any_other_service_fails_its_test(request_: str) -> None:
    sent = SentByUs()
    sent.note_frame(frame(request_))
    with pytest.raises(AssertionError, match=r"sent: (10|2E|31|2C) 1"):
        sent.check(may_define=False)


def test_lines_messages_over_ip_and_groups_are_counted() -> None:
    sent = SentByUs()
    sent.note_line(b"ATZ\r")
    sent.note_line(b"2238EB\r")
    sent.note_over_ip(bytes.fromhex("02FD800100000006 0E001011 1003"))
    sent.note_over_ip(bytes.fromhex("02FD800100000006 10110E00 5003"))
    sent.note_frame(frame("F8 FE 00", 0x18EAFFF9))
    assert sent.services == {0x22: 1, 0x10: 1, 0xEA: 1}
    sent.note_frame(frame("40 00"))
    assert sent.odd == ["7E1 4000"]


def test_all_tests_that_ask_are_watched() -> None:
    folder = Path(__file__).parents[1]
    asking = [path for path in folder.rglob("test_*.py") if ASKS.search(path.read_text("utf-8"))]
    assert len(asking) >= 5
    assert [path.name for path in asking if "pytest.mark.asks" not in path.read_text("utf-8")] == []
