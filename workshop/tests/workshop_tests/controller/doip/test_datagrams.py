"""DoIP: datagrams and the place to listen."""

import pytest

from ecu_emulator.errors import EmulatorConfigError
from tests.support.doip.desk import ENTITY, framed
from tests.support.uds.full_table import full_text
from workshop.controller.doip import datagram_reply
from workshop.controller.table import parse_table

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


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("logical_address = 0x0E00", "logical_address and functional_address must differ"),
        ("functional_address = 0x1011", "logical_address and functional_address must differ"),
        ("logical_address = 0", "addresses must be"),
        ("first_tester = 0xFFF0", "first_tester must not be above"),
        ("eid = 0x1000000000000", "must have six bytes"),
        ("version = 1", "version must be 2"),
        ("most_sockets = 0", "most_sockets must be 1..255"),
        ("most_request_bytes = 5000", "most_request_bytes must be"),
        ("alive_check_s = 0", "alive_check_s must be above 0"),
        ("announce_wait_s = 60", "announce_wait_s must be 0..10 s"),
        ("announce_count = 11", "announce_count must be at most 10"),
        ("activation_types = [256]", "activation_types must be"),
        ("ecu = 1", "doip.ecu is unknown"),
    ],
)
def test_an_entity_that_cannot_be_is_named(line: str, message: str) -> None:
    before, _, after = full_text().partition("[doip]")
    rest = after[after.index("[timing]") :]
    with pytest.raises(EmulatorConfigError, match=message):
        parse_table(f"{before}[doip]\n{line}\n{rest}", "table")
