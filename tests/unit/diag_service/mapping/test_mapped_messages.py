"""Values of mapped messages, and which tier of signals they make."""

import cantools
import numpy as np
import pytest
from cantools.database.can import Database, Message

from canlog.arrays import UInt8Array
from canlog.database.loading import load_database
from canlog.decode.signals import InvalidCounts, PayloadWords
from clutch_results.records import Tier
from diag_service.diagnosis.columns import Signal
from diag_service.errors import ConfigError
from diag_service.mapping.decoder import is_able
from diag_service.mapping.mapped_messages import (
    compile_source,
    find_message,
    map_signals,
    missing_for_next,
    signal_name,
    tier_of,
)
from diag_service.mapping.profile import PROFILE_FOLDER, BusSource, load_shipped

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
    source = BusSource(message="M", signal="Share", less="Loss", times="Standard")
    found = compile_source(message(), source).decode(PayloadWords(payloads((120, 20, 40))))
    assert found.value.tolist() == [(60.0 - 10.0) * 400.0]
    assert (found.is_good, found.invalid.total) == (None, 0)


def test_a_neighbour_without_value_takes_the_value_away() -> None:
    source = BusSource(message="M", signal="Share", less="Loss", times="Standard")
    found = compile_source(message(), source).decode(PayloadWords(payloads((120, 20, 40), (120, 255, 40), (255, 0, 0))))
    assert found.is_good is not None
    assert found.is_good.tolist() == [True, False, False]
    assert found.invalid.total == 2


def test_valid_range_and_codes_of_the_profile() -> None:
    source = BusSource(message="M", signal="Share", check_range=False, valid=(0.0, 50.0), invalid=(7.5,))
    found = compile_source(message(), source).decode(PayloadWords(payloads((0, 0, 0), (15, 0, 0), (101, 0, 0))))
    assert found.is_good is not None
    assert (found.is_good.tolist(), found.invalid.total) == ([True, False, False], 2)


def test_numbers_that_stand_for_others() -> None:
    source = BusSource(message="M", signal="Loss", scale=2.0, values=(7.0, 0.0, 5.0), invalid=(0.5,))
    rows = [(0, code, 0) for code in (0, 1, 2, 4, 6, 255)]  # decoded as 0, .5, 1, 2, 3, ...
    found = compile_source(message(), source).decode(PayloadWords(payloads(*rows)))
    assert found.is_good is not None
    assert found.is_good.tolist() == [True, False, True, True, False, False]
    assert found.value[found.is_good].tolist() == [7.0, 0.0, 5.0]
    assert found.invalid.total == 3
    assert not is_able(compile_source(message(), source))


PQ = """VERSION ""
BO_ 1088 Getriebe_1: 8 T
 SG_ GE1_Zielgang : 8|4@1+ (1,0) [0|15] "" X
BO_ 640 Motor_1: 8 M
 SG_ Motordrehzahl : 16|16@1+ (0.25,0) [0|16256] "U/min" X
BO_ 648 Motor_2: 8 M
 SG_ MO2_Kuehlm_T : 8|8@1+ (0.75,-48) [-47.25|142.5] "°C" X
BO_ 896 Motor_3: 8 M
 SG_ MO3_Pedalwert : 16|8@1+ (0.4,0) [0|101.6] "%" X
BO_ 416 Bremse_1: 8 B
 SG_ BR1_Rad_kmh : 17|15@1+ (0.01,0) [0|326.39] "km/h" X
BO_ 1184 Bremse_3: 8 B
 SG_ Radgeschw__HR_4_1 : 49|15@1+ (0.01,0) [0|326] "km/h" X
 SG_ Radgeschw__HL_4_1 : 33|15@1+ (0.01,0) [0|326] "km/h" X
 SG_ Radgeschw__VR_4_1 : 17|15@1+ (0.01,0) [0|326] "km/h" X
 SG_ Radgeschw__VL_4_1 : 1|15@1+ (0.01,0) [0|326] "km/h" X
"""


def test_gears_of_vw_pq_are_those_of_its_table_of_values() -> None:
    database = cantools.database.load_string(PQ, "dbc")
    assert isinstance(database, Database)
    columns = {column.signal: column for one in map_signals(database, load_shipped("vw_pq")) for column in one.columns}
    assert set(columns) == set(load_shipped("vw_pq").sources)
    found = columns[Signal.TARGET_GEAR].table.decode(PayloadWords(payloads(*((0, code, 0) for code in range(16)))))
    assert found.is_good is not None
    gears = [int(value) if good else None for value, good in zip(found.value, found.is_good, strict=True)]
    assert gears == [0, 1, 2, 3, 4, 5, None, None, 6, 7, 8, None, None, None, None, None]
    assert tier_of(set(columns), knows_gears=True) is Tier.KINEMATIC  # as `learn` finds them


def test_j1939_numbers() -> None:
    database = load_database(PROFILE_FOLDER / "j1939.dbc")
    found = find_message(database.messages, BusSource(pgn=61444, spn=190))
    assert (found.name, signal_name(found, BusSource(pgn=61444, spn=190))) == ("EEC1", "EngineSpeed")
    with pytest.raises(ConfigError, match="no message of PGN 99"):
        find_message(database.messages, BusSource(pgn=99, spn=1))
    with pytest.raises(ConfigError, match="EEC1 has no signal with SPN 7"):
        signal_name(found, BusSource(pgn=61444, spn=7))


def test_why_values_are_no_measurements_is_counted() -> None:
    found = compile_source(
        message(), BusSource(message="M", signal="Share", times="Standard", valid=(0.0, 90.0), invalid=(7.5,))
    ).decode(PayloadWords(payloads((15, 0, 0), (190, 0, 0), (255, 0, 0), (1, 0, 255), (1, 0, 1))))
    assert found.is_good is not None
    assert found.is_good.tolist() == [False, False, False, False, True]
    assert found.invalid == InvalidCounts(not_available=1, out_of_range=2, incomplete=1)


DCT = frozenset(load_shipped("dct").sources)
PRESSURES = {Signal.CLUTCH1_PRESSURE, Signal.CLUTCH2_PRESSURE}
TORQUES = {Signal.ENGINE_TORQUE, Signal.CLUTCH1_TORQUE_COMMAND, Signal.CLUTCH2_TORQUE_COMMAND}


@pytest.mark.parametrize(
    ("signals", "tier"),
    [
        (DCT, Tier.FRICTION),
        (DCT - {Signal.CURRENT_GEAR}, Tier.FRICTION),
        (DCT - PRESSURES, Tier.TORQUE),
        (DCT - {Signal.SUMP_TEMPERATURE}, Tier.TORQUE),
        (DCT - {Signal.CLUTCH1_PRESSURE} - TORQUES, Tier.KINEMATIC),
        (DCT - PRESSURES - {Signal.CURRENT_GEAR}, Tier.TORQUE),
        ({Signal.ENGINE_SPEED, Signal.CURRENT_GEAR}, Tier.KINEMATIC),
        ({Signal.ENGINE_SPEED, Signal.TARGET_GEAR}, None),
        ({Signal.CURRENT_GEAR, Signal.TARGET_GEAR}, None),
        (set(), None),
        *((frozenset(load_shipped(name).sources), Tier.TORQUE) for name in ("vw_mqb", "vw_mqbevo", "hyundai_dct")),
        (frozenset(load_shipped("j1939").sources), Tier.KINEMATIC),
        (frozenset(load_shipped("vw_pq").sources), None),  # no speed of an input shaft
    ],
)
def test_tiers(signals: frozenset[Signal], tier: Tier | None) -> None:
    assert tier_of(signals) == tier


def test_what_is_missing_is_named() -> None:
    assert missing_for_next(DCT) == ""
    assert missing_for_next(DCT - PRESSURES) == "friction needs clutch 1 pressure, clutch 2 pressure"
    assert missing_for_next(DCT - PRESSURES - TORQUES) == (
        "torque capacity needs engine torque, clutch torque or commanded clutch 1 torque and commanded clutch 2 torque"
    )
    assert missing_for_next({Signal.ENGINE_SPEED}) == (
        "shift time and slip need current gear or input shaft speed and target gear "
        "or input shaft 1 speed and input shaft 2 speed and target gear"
    )
