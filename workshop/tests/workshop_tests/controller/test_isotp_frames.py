"""What ISO 15765-2 says of odd frames: most are ignored, some are read as something else."""

import pytest

from workshop.isotp_frames import single_payload, usable


@pytest.mark.parametrize(
    ("frame", "payload"),
    [
        ("02 3e 00", "3e 00"),
        ("02 3e 00 cc cc cc cc cc", "3e 00"),
        ("07 01 02 03 04 05 06 07", "01 02 03 04 05 06 07"),
        ("00 3e", None),  # no length
        ("00 02 3e 00 00 00 00 00", None),  # the long form is for long frames
        ("08 01 02 03 04 05 06 07", None),
        ("03 3e 00", None),  # shorter than it says
        ("", None),
        ("02", None),
        ("10 08 3e", None),
        ("00 09 " + "11 " * 10, "11 " * 9),
        ("00 07 " + "11 " * 10, None),  # would have fitted a short one
        ("00 0b " + "11 " * 10, None),
        ("02 3e 00 " + "cc " * 9, None),  # a long frame needs the long form
    ],
)
def test_a_single_frame(frame: str, payload: str | None) -> None:
    found = single_payload(bytes.fromhex(frame), 0)
    assert found == (None if payload is None else bytes.fromhex(payload))


@pytest.mark.parametrize(
    "frame",
    [
        "40 01 02",  # no such type
        "f0",
        "10 07 22 01 00 01 01 01",  # a single frame would do
        "10 08 22 01 00 01 01",  # not full
        "10 00 00 00 0f ff 22 01",  # the long form for a short length
        "10 3e " + "11 " * 62,
        "21",
        "21 01 02",  # not full, and not the last
        "30 00",
        "",
    ],
)
def test_frames_that_the_standard_ignores(frame: str) -> None:
    assert usable(bytes.fromhex(frame), 0, 100) is None


def test_flow_control_that_is_not_known_aborts_and_a_reserved_pause_is_the_longest() -> None:
    assert usable(b"\x33\0\0", 0, 0) == b"\x32\0\0"
    for reserved in (0x80, 0xF0, 0xFA, 0xFF):
        assert usable(bytes([0x30, 4, reserved]), 0, 0) == b"\x30\x04\x7f"
    assert usable(b"\xf1\x30\x00\x80", 1, 0) == b"\xf1\x30\x00\x7f"
