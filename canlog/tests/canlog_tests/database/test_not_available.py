"""Codes that are no measurements: by the conventions of senders, never by an alarming name alone."""

import pytest
from cantools.database.can import Message
from cantools.database.can.signal import Signal
from cantools.database.conversion import BaseConversion

from canlog.database.not_available import CodeRange, no_value_codes, says_no_value

EEC1 = 0x0CF00400
PROPRIETARY_B = 0x18FF1000


def codes(
    length: int,
    texts: dict[int, str] | None = None,
    *,
    is_signed: bool = False,
    can_id: int = 0x100,
    protocol: str | None = None,
) -> tuple[CodeRange, ...]:
    """Return the codes of a message's only signal."""
    conversion = BaseConversion.factory(choices=texts)  # type: ignore[arg-type]  # cantools wants its own mapping type
    signal = Signal("S", start=0, length=length, is_signed=is_signed, conversion=conversion)
    message = Message(can_id, "M", 8, [signal], is_extended_frame=can_id > 0x7FF, protocol=protocol)
    return no_value_codes(message, signal)


@pytest.mark.parametrize(
    ("length", "texts", "expected"),
    [
        (8, {255: "SNA"}, ((255, 255),)),
        (8, {253: "ok", 254: "Error", 255: "Not available"}, ((254, 255),)),  # the run ends at a value
        (8, {0: "Fault", 3: "not available", 254: "Error"}, ()),  # not at the end of the scale
        (8, {255: "Open"}, ()),
        (8, {255: "kein_Fehler"}, ()),
        (8, {255: "No Fault"}, ()),
        (1, {0: "No Fault", 1: "Fault"}, ()),  # a bit has no value to spare
        (2, {0: "off", 1: "on", 2: "error", 3: "not available"}, ((2, 3),)),
        (4, dict.fromkeys(range(16), "invalid"), ((0, 15),)),
    ],
)
def test_named_codes_at_the_end_of_the_scale(
    length: int, texts: dict[int, str], expected: tuple[CodeRange, ...]
) -> None:
    assert codes(length, texts) == expected


@pytest.mark.parametrize(
    ("length", "expected"),
    [
        (1, ()),
        (2, ((2, 3),)),
        (4, ((14, 15),)),
        (5, ((31, 31),)),
        (8, ((0xFB, 0xFF),)),
        (12, ((0xFB0, 0xFFF),)),
        (16, ((0xFB00, 0xFFFF),)),
        (32, ((0xFB000000, 0xFFFFFFFF),)),
    ],
)
def test_j1939_sets_codes_apart(length: int, expected: tuple[CodeRange, ...]) -> None:
    assert codes(length, can_id=EEC1, protocol="j1939") == expected
    assert codes(length, can_id=EEC1) == ()  # the database does not call it J1939
    assert codes(length, can_id=PROPRIETARY_B, protocol="j1939") == ()


@pytest.mark.parametrize(
    "text",
    ["NotAvailable", "not available", "N/A", "n.a. SNA", "Fehler", "ungueltig", "Init", "Sensor_error", "SensorFault",
     "not initialised", "nicht verfügbar"],
)  # fmt: skip
def test_texts_that_say_not_available(text: str) -> None:
    assert says_no_value(text)


@pytest.mark.parametrize(
    "text",
    ["None", "Neutral", "Hold", "Gear 1", "Manual", "Nacht", "Terror", "Final", "Snack", "No Fault", "NoError",
     "kein_Fehler", "no errors", "not faulty"],
)  # fmt: skip
def test_texts_that_are_values(text: str) -> None:
    assert not says_no_value(text)
