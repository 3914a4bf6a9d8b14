"""What sets of signals suffice for, and what is said to be missing."""

import pytest

from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.records import Tier
from diag_service.mapping.profile import load_shipped
from diag_service.mapping.tiers import missing_for_next, tier_of

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
        *((frozenset(load_shipped(name).sources), Tier.TORQUE) for name in ("vw_mqb", "hyundai_dct")),
        (frozenset(load_shipped("j1939").sources), Tier.KINEMATIC),
    ],
)
def test_tiers(signals: frozenset[Signal], tier: Tier | None) -> None:
    assert tier_of(signals) == tier


def test_what_is_missing_is_named() -> None:
    assert missing_for_next(DCT) == ""
    assert missing_for_next(DCT - PRESSURES) == "friction needs clutch1_pressure_pa, clutch2_pressure_pa"
    assert missing_for_next(DCT - PRESSURES - TORQUES) == (
        "torque capacity needs engine_torque_nm, "
        "clutch1_torque_command_nm and clutch2_torque_command_nm or clutch_torque_nm"
    )
    assert missing_for_next({Signal.ENGINE_SPEED}).startswith(
        "shift time and slip need current_gear and target_gear or "
    )
