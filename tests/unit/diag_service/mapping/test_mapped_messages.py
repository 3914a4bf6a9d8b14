"""Sources of a profile, compiled: found by name or J1939 numbers, corrected by their neighbours, checked."""

import cantools
import numpy as np
import pytest
from cantools.database.can import Database, Message

from canlog.arrays import UInt8Array
from canlog.database.loading import load_database
from canlog.decode.signals import InvalidCounts, PayloadWords
from diag_service.errors import ConfigError
from diag_service.mapping.mapped_messages import compile_source, find_message, signal_name
from diag_service.mapping.profile import PROFILE_FOLDER, SignalSource

TEXT = """VERSION ""
BU_: A
BO_ 256 M: 4 A
 SG_ Share : 0|8@1+ (0.5,0) [0|100] "%" A
 SG_ Loss : 8|8@1+ (0.5,0) [0|100] "%" A
 SG_ Standard : 16|8@1+ (10,0) [0|2000] "Nm" A
"""


def message() -> Message:
    database = cantools.database.load_string(TEXT, "dbc")
    assert isinstance(database, Database)
    return database.messages[0]


def payloads(*rows: tuple[int, int, int]) -> UInt8Array:
    return np.array([[*row, 0, 0, 0, 0, 0] for row in rows], np.uint8)


def test_a_share_of_a_standard_torque_less_the_loss() -> None:
    source = SignalSource(message="M", signal="Share", less="Loss", times="Standard")
    found = compile_source(message(), source).decode(PayloadWords(payloads((120, 20, 40))))
    assert found.value.tolist() == [(60.0 - 10.0) * 400.0]
    assert (found.is_good, found.invalid.total) == (None, 0)


def test_a_neighbour_without_value_takes_the_value_away() -> None:
    source = SignalSource(message="M", signal="Share", less="Loss", times="Standard")
    found = compile_source(message(), source).decode(PayloadWords(payloads((120, 20, 40), (120, 255, 40), (255, 0, 0))))
    assert found.is_good is not None
    assert found.is_good.tolist() == [True, False, False]
    assert found.invalid.total == 2


def test_valid_range_and_codes_of_the_profile() -> None:
    source = SignalSource(message="M", signal="Share", check_range=False, valid=(0.0, 50.0), invalid=(7.5,))
    found = compile_source(message(), source).decode(PayloadWords(payloads((0, 0, 0), (15, 0, 0), (101, 0, 0))))
    assert found.is_good is not None
    assert (found.is_good.tolist(), found.invalid.total) == ([True, False, False], 2)


def test_j1939_numbers() -> None:
    database = load_database(PROFILE_FOLDER / "j1939.dbc")
    found = find_message(database.messages, SignalSource(pgn=61444, spn=190))
    assert (found.name, signal_name(found, SignalSource(pgn=61444, spn=190))) == ("EEC1", "EngineSpeed")
    with pytest.raises(ConfigError, match="no message of PGN 99"):
        find_message(database.messages, SignalSource(pgn=99, spn=1))
    with pytest.raises(ConfigError, match="EEC1 has no signal with SPN 7"):
        signal_name(found, SignalSource(pgn=61444, spn=7))


def test_why_values_are_no_measurements_is_counted() -> None:
    found = compile_source(
        message(), SignalSource(message="M", signal="Share", times="Standard", valid=(0.0, 90.0), invalid=(7.5,))
    ).decode(PayloadWords(payloads((15, 0, 0), (190, 0, 0), (255, 0, 0), (1, 0, 255), (1, 0, 1))))
    assert found.is_good is not None
    assert found.is_good.tolist() == [False, False, False, False, True]
    assert found.invalid == InvalidCounts(not_available=1, out_of_range=2, incomplete=1)
