"""Columns of characters against Python's own formatting."""

import numpy as np

from ecu_emulator.log_formats import text


def test_decimal_digits() -> None:
    value = np.array([0, 7, 123_456, 999_999])
    assert text.lines([text.decimal(value, 6)]).decode().splitlines() == [f"{number:06d}" for number in value]


def test_identifiers() -> None:
    can_id = np.array([0, 0x7FF, 0x8000_0000, 0x9FFF_FFFF, 0x98FE_F100], np.uint32)
    assert text.lines([text.identifier(can_id)]).decode().splitlines() == [
        "000",
        "7FF",
        "00000000",
        "1FFFFFFF",
        "18FEF100",
    ]


def test_payloads_end_with_their_length() -> None:
    data = np.arange(24, dtype=np.uint8).reshape(3, 8) * 11
    length = np.array([0, 3, 8], np.uint8)
    assert text.lines([text.payload(data, length)]).decode().split("\n") == [
        "",
        data[1, :3].tobytes().hex().upper(),
        data[2].tobytes().hex().upper(),
        "",
    ]
    assert text.lines([text.payload(data, length, separator=" ")]).decode().split("\n")[1] == " 58 63 6E"


def test_lines_join_their_parts() -> None:
    condition = np.array([True, False])
    parts = [text.constant("(", 2), text.when(condition, "xy"), text.constant(")", 2)]
    assert text.lines(parts) == b"(xy)\n()\n"
    assert text.lines([text.constant("(", 0)]) == b""
