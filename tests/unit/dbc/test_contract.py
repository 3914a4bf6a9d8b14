"""The database file keeps what the wire contract promises."""

import cantools
import pytest
from cantools.database.can.signal import Signal

from canlog.e2e.message_contract import PROTECTION_SIGNALS, MessageContract, message_contracts
from canlog.e2e.profile1 import DATA_START_BIT
from dbc.contract import load_contract

DATABASES = {name: load_contract(name) for name in ("nominal", "lockup")}
CONTRACTS = {name: message_contracts(database) for name, database in DATABASES.items()}
MESSAGES = [
    pytest.param(message, CONTRACTS[name][message.name], id=f"{name} {message.name}")
    for name, database in DATABASES.items()
    for message in database.messages
]
SIGNALS = [
    pytest.param(signal, id=f"{name} {message.name}.{signal.name}")
    for name, database in DATABASES.items()
    for message in database.messages
    for signal in message.signals
    if signal.name not in PROTECTION_SIGNALS
]
SHARED = {
    "ECM_TorqueSpeed": (0x0A0, "ECM", 10, 0),
    "ECM_Temperature": (0x0A8, "ECM", 100, 4),
    "ECM_State": (0x0A9, "ECM", 100, 4),
    "TCU_Temperature": (0x0B8, "TCU", 100, 5),
    "BRK_WheelSpeeds": (0x0C0, "ABS", 20, 3),
    "BRK_Vehicle": (0x0C1, "ABS", 20, 3),
    "IC_Odometer": (0x0D0, "IC", 1000, 6),
}


def test_timing_of_every_message() -> None:
    dual_clutch, automatic = (
        {name: (c.can_id, c.sender, c.cycle_ms, c.phase_ms) for name, c in contracts.items()}
        for contracts in CONTRACTS.values()
    )
    assert dual_clutch == SHARED | {
        "TCU_InputSpeeds": (0x0B0, "TCU", 10, 1),
        "TCU_Pressures": (0x0B1, "TCU", 10, 1),
        "TCU_Output": (0x0B2, "TCU", 10, 2),
        "TCU_Shift": (0x0B3, "TCU", 10, 2),
        "TCU_Drive": (0x0B4, "TCU", 20, 2),
    }
    assert automatic == SHARED | {
        "TCU_Turbine": (0x0B5, "TCU", 10, 1),
        "TCU_LockUp": (0x0B6, "TCU", 10, 1),
        "TCU_Gear": (0x0B7, "TCU", 10, 2),
    }


def test_data_ids_tell_the_messages_apart() -> None:
    data_ids = {(name, one.data_id) for contracts in CONTRACTS.values() for name, one in contracts.items()}
    assert len({data_id for _, data_id in data_ids if data_id is not None}) == len(data_ids)


@pytest.mark.parametrize(("message", "contract"), MESSAGES)
def test_protection_fields_lie_where_profile_1_wants_them(
    message: cantools.database.can.Message, contract: MessageContract
) -> None:
    fields = {signal.name: (signal.start, signal.length) for signal in message.signals}
    assert fields.pop("Crc8") == (0, 8)
    assert fields.pop("AliveCounter") == (8, 4)
    assert min(start for start, _ in fields.values()) == DATA_START_BIT
    assert contract.signals == tuple(fields)
    assert message.length == 8
    assert message.comment


@pytest.mark.parametrize("signal", SIGNALS)
def test_highest_raw_value_says_not_available(signal: Signal) -> None:
    highest = 2**signal.length - 1
    assert signal.choices is not None
    assert str(signal.choices[highest]) == "NotAvailable"
    assert signal.raw_initial == highest
    assert signal.minimum is not None
    assert signal.maximum is not None
    assert signal.minimum == signal.offset
    assert signal.maximum < signal.offset + signal.scale * highest
    assert signal.comment
