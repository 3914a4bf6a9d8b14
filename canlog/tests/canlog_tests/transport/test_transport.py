"""What each protocol says of messages that are not whole."""

import pytest

from canlog.transport import Fault, Protocol, Reassembler, Transfer
from tests.support.transport_traffic import MS, Sent, batch_of


def frames(*lines: tuple[int, int, str]) -> list[Sent]:
    return [Sent(t_ns=t_ms * MS, can_id=can_id, data=bytes.fromhex(data), message=-1) for t_ms, can_id, data in lines]


def put_together(*lines: tuple[int, int, str]) -> tuple[list[Transfer], dict[tuple[Protocol, Fault], int]]:
    reassembler = Reassembler()
    found = reassembler.feed(batch_of(frames(*lines))) + reassembler.close()
    return found, reassembler.counts.incomplete


TP_CM, TP_DT = 0x9CECFF00, 0x9CEBFF00
TO_CM, TO_DT, BACK_CM = 0x9CECF900, 0x9CEBF900, 0x9CEC00F9


@pytest.mark.parametrize(
    ("lines", "protocol", "fault"),
    [
        ([(0, 0x7E8, "1014620102030405"), (5, 0x7E8, "2206070809101112")], Protocol.ISO_TP, Fault.FRAME_MISSING),
        ([(0, 0x7E8, "1014620102030405"), (1500, 0x7E8, "2106070809101112")], Protocol.ISO_TP, Fault.TIMEOUT),
        ([(0, 0x7E8, "1014620102030405"), (5, 0x7E0, "3200000000000000")], Protocol.ISO_TP, Fault.ABORTED),
        ([(0, 0x7E8, "1014620102030405"), (5, 0x7E0, "0322F19000000000")], Protocol.ISO_TP, Fault.INTERRUPTED),
        ([(0, 0x7E8, "1014620102030405")], Protocol.ISO_TP, Fault.CUT_OFF),
        ([(0, 0x7E8, "1004620102030405")], Protocol.ISO_TP, Fault.WRONG_LENGTH),
        ([(0, 0x7E8, "0862010203040506")], Protocol.ISO_TP, Fault.WRONG_LENGTH),
        ([(0, 0x7E8, "2106070809101112")], Protocol.ISO_TP, Fault.NO_BEGINNING),
        ([(0, 0x7E0, "3000000000000000")], Protocol.ISO_TP, Fault.NO_BEGINNING),
        ([(0, 0x7E0, "3100"), (5, 0x7E0, "3000"), (9, 0x7E8, "21060708")], Protocol.ISO_TP, Fault.NO_BEGINNING),
        ([(0, TP_CM, "200A0002FFCAFE00"), (60, TP_DT, "02FFFFFFFFFFFFFF")], Protocol.J1939_TP, Fault.FRAME_MISSING),
        ([(0, TP_CM, "200A0009FFCAFE00")], Protocol.J1939_TP, Fault.WRONG_LENGTH),
        ([(0, TP_DT, "0101020304050607")], Protocol.J1939_TP, Fault.NO_BEGINNING),
        ([(0, BACK_CM, "110201FFFFCAFE00"), (4, TO_DT, "0101020304050607")], Protocol.J1939_TP, Fault.NO_BEGINNING),
        ([(0, BACK_CM, "130A0002FFCAFE00")], Protocol.J1939_TP, Fault.NO_BEGINNING),
        ([(0, TO_DT, "0201020304050607"), (4, BACK_CM, "130A0002FFCAFE00")], Protocol.J1939_TP, Fault.NO_BEGINNING),
        ([(0, TO_CM, "100A0002FFCAFE00"), (5, BACK_CM, "FF01FFFFFFCAFE00")], Protocol.J1939_TP, Fault.ABORTED),
    ],
)
def test_what_is_not_whole_is_counted_with_its_reason(
    lines: list[tuple[int, int, str]], protocol: Protocol, fault: Fault
) -> None:
    found, incomplete = put_together(*lines)
    assert [one for one in found if len(one.data) > 7] == []
    assert incomplete[protocol, fault] == 1


@pytest.mark.parametrize(
    ("lines", "counted"),
    [
        # Flow control again where none can come any more: it speaks of the next message.
        ([(0, 0x7E8, "100D010203040506"), (2, 0x7E0, "3003"), (60, 0x7E0, "3003"), (62, 0x7E8, "2106070809101112")], 2),
        ([(0, 0x7E8, "1014010203040506"), (2, 0x7E0, "3000"), (60, 0x7E0, "3000"), (62, 0x7E8, "2106070809101112")], 2),
        # Two of one block each: the message goes on.
        ([(0, 0x7E8, "2106070809101112"), (2, 0x7E0, "3001"), (4, 0x7E8, "2206070809101112")], 1),
        # Fewer frames are lost if it is another message, and if it is the same.
        ([(0, 0x7E8, "2506070809101112"), (2, 0x7E8, "2106070809101112")], 2),
        ([(0, 0x7E8, "2D06070809101112"), (2, 0x7E8, "2106070809101112")], 2),
        ([(0, 0x7E8, "2106070809101112"), (2, 0x7E8, "2706070809101112")], 1),
        # A block of three of which nothing came: what comes next shows whether the message goes on.
        ([(0, 0x7E8, "2E" + "00" * 7), (2, 0x7E0, "3003"), (9, 0x7E0, "3003"), (11, 0x7E8, "2200000000000000")], 1),
        ([(0, 0x7E8, "2900000000000000"), (2, 0x7E0, "3003"), (9, 0x7E0, "3003"), (11, 0x7E8, "21" + "00" * 7)], 2),
        # Nothing comes: it was of another message if it came later than a sender takes for its frames.
        ([(0, 0x7E0, "3003"), (2, 0x7E8, "2100000000000000"), (9, 0x7E0, "3003")], 1),
        ([(0, 0x7E0, "3003"), (2, 0x7E8, "2100000000000000"), (90, 0x7E0, "3003")], 2),
        # Whoever sends waits for no frame any more: flow control behind it is that for another message.
        ([(0, 0x7E8, "1014010203040506"), (2, 0x7E0, "3003"), (5, 0x7E0, "10"), (60, 0x7E0, "3003")], 3),
        # Whoever receives has ended its own message: what it sends behind that is of another.
        ([(0, 0x7E8, "100A010203040506"), (60, 0x7E8, "3000"), (99, 0x7E8, "2107080910FFFFFF")], 3),
        # Packets of another message for all, whose announcement is missing.
        ([(0, TP_CM, "20150003FFCAFE00"), (60, TP_DT, "01" * 8), (120, TP_DT, "02" * 8), (400, TP_DT, "02" * 8)], 2),
        ([(0, TO_CM, "10150003FFCAFE00"), (4, TO_DT, "0101010101010101"), (8, TO_DT, "0601010101010101")], 2),
        ([(0, TO_CM, "10150003FFCAFE00"), (4, BACK_CM, "13150003FFCAFE00"), (60, TO_DT, "0101010101010101")], 2),
        ([(0, TO_CM, "10150003FFCAFE00"), (60, BACK_CM, "130A0002FFCAFE00")], 2),
        # Of a slow sender packets are lost: the others come as much later.
        ([(0, TP_CM, "20230005FFCAFE00"), (380, TP_DT, "02" * 8), (760, TP_DT, "04" * 8), (950, TP_DT, "05" * 8)], 1),
        # A receiver that lets a sender wait, and then begin.
        ([(0, BACK_CM, "1100FFFFFFCAFE00"), (60, BACK_CM, "110201FFFFCAFE00"), (64, TO_DT, "02" * 8)], 1),
    ],
)
def test_what_is_left_of_two_messages_is_counted_twice_and_of_one_once(
    lines: list[tuple[int, int, str]], counted: int
) -> None:
    found, incomplete = put_together(*lines)
    assert (found, sum(incomplete.values())) == ([], counted)


def test_a_frame_of_another_sender_or_channel_does_not_interrupt() -> None:
    found, incomplete = put_together(
        (0, 0x7E8, "100A620102030405"), (1, 0x7E9, "100A720102030405"), (2, 0x7E0, "023E000000000000"),
        (3, 0x7E8, "2106070809000000"), (4, 0x7E9, "2116171819000000"),
    )  # fmt: skip
    assert [one.data.hex() for one in found] == ["3e00", "62010203040506070809", "72010203040516171819"]
    assert incomplete == {}
