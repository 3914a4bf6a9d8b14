"""Answers of service 19 taken apart, also those of controllers that are not described."""

from diag_service.tester.answers import belongs
from diag_service.tester.description import UNKNOWN, Datum, Description, Field, Kind, Trouble
from diag_service.tester.trouble import read_codes, read_extended, read_snapshots

SPEED = Field(name="speed", kind=Kind.UNSIGNED, size_bytes=2, unit="km/h", resolution=0.01, invalid=0xFFFF)
KNOWN = Description(
    name="known",
    data={0x0102: Datum(number=0x0102, name="vehicle speed", fields=(SPEED,))},
    extended={
        0x01: Datum(number=1, name="counter", fields=(Field(name="times", kind=Kind.UNSIGNED, size_bytes=1),)),
        0x10: Datum(number=16, name="at the failure", fields=(SPEED,)),
    },
    troubles=(
        Trouble(code="P0811", text="slips"),
        Trouble(code="P0811", text="slips too much", failure_type=0x07),
        Trouble(code="U3FFF", text="bus", failure_type=0x00),
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


def test_a_cut_answer_gives_what_is_whole() -> None:
    assert [one.code for one in read_codes(bytes.fromhex("59 02 FF 081107 2F 0897"), UNKNOWN)] == ["P0811"]
    assert read_codes(bytes.fromhex("59 02"), UNKNOWN) == ()


def test_snapshots_are_data_with_their_units() -> None:
    found = read_snapshots(bytes.fromhex("59 04 081107 2F 01 01 0102 1234 02 02 0102 FFFF 0102 0001"), KNOWN)
    assert [(one.number, one.data, one.rest) for one in found] == [
        (1, {"vehicle speed": {"speed [km/h]": 46.6}}, b""),
        (2, {"vehicle speed": {"speed [km/h]": None}, "vehicle speed (0102)": {"speed [km/h]": 0.01}}, b""),
    ]


def test_data_of_unknown_length_are_left_as_bytes() -> None:
    (found,) = read_snapshots(bytes.fromhex("59 04 081107 2F 01 02 0102 1234 0999 AABB"), KNOWN)
    assert found.data == {"vehicle speed": {"speed [km/h]": 46.6}}
    assert found.rest == bytes.fromhex("0999 AABB")
    assert read_snapshots(bytes.fromhex("59 04 081107 2F"), KNOWN) == ()


def test_extended_records_are_told_apart_while_their_length_is_known() -> None:
    found = read_extended(bytes.fromhex("59 06 081107 2F 01 05 10 1234 77 010203"), KNOWN)
    assert [one.data for one in found] == [{"counter": {"times": 5}}, {"at the failure": {"speed [km/h]": 46.6}}, {}]
    assert (found[-1].number, found[-1].rest) == (0x77, b"\1\2\3")


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
