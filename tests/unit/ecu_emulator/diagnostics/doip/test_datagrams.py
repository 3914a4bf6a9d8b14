"""What is said to a datagram, byte by byte."""

import pytest

from ecu_emulator.diagnostics.doip.messages import datagram_reply
from tests.support.doip.desk import ENTITY, framed

VIN = b"WDCTEMUL3TED00047"
IDENTITY = VIN.hex() + "1011" + "020000001011" * 2 + "0000"


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (framed(1), "03fc000400000021" + IDENTITY),
        (framed(1, version=2), "02fd000400000021" + IDENTITY),
        (framed(1, version=0xFF), "03fc000400000021" + IDENTITY),  # one who does not know which version to speak
        (framed(2, "020000001011"), "03fc000400000021" + IDENTITY),
        (framed(2, "020000001012"), None),
        (framed(3, VIN), "03fc000400000021" + IDENTITY),
        (framed(3, VIN[:-1] + b"2"), None),
        (framed(0x4001), "03fc400200000007" + "01" + "04" + "02" + "00000fff"),
        (framed(0x4003, version=2), "02fd400400000001" + "01"),
        (framed(0x4003, version=0xFF), "03fc00000000000100"),
        (framed(5, "0e000000000000"), "03fc00000000000101"),  # for connections only
        (framed(2, "0200"), "03fc00000000000104"),
        (framed(1)[:-1], "03fc00000000000100"),
        (framed(1) + b"\0", "03fc00000000000104"),
        (framed(2, "020000001011")[:-1], "03fc00000000000104"),
        (b"", "03fc00000000000100"),
        (bytes.fromhex("03fc000300010001"), "03fc00000000000102"),
        (framed(4, VIN), None),  # announcements and refusals of others
        (framed(0, "00"), None),
    ],
)
def test_a_datagram_is_answered(data: bytes, told: str | None) -> None:
    reply = datagram_reply(ENTITY, VIN, 2, data)
    assert (reply.data.hex() if reply is not None else None) == told
