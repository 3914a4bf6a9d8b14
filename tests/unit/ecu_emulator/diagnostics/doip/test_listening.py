"""Where to listen, as it is written on a command line and in a table."""

import pytest

from ecu_emulator.diagnostics.table_file import parse_table
from ecu_emulator.errors import ConfigError
from tests.support.uds.full_table import full_text


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
    with pytest.raises(ConfigError, match=message):
        parse_table(f"{before}[doip]\n{line}\n{rest}", "table")
