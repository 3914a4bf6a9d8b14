"""Indices of a made-up shift whose every number is known."""

import numpy as np
import pytest

from canlog.arrays import FloatArray, Series
from clutch_model.calibration import nominal_calibration
from clutch_results.event_kinds import EndReason
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.condition.shift_indices import measure
from diag_service.diagnosis.events import Event

CALIBRATION = nominal_calibration()
STEP_NS = 10_000_000
START_NS = 1_000_000_000
ROWS = np.arange(-50, 110)
T_S = ROWS * 0.01
INERTIA_KG_M2 = CALIBRATION.input_side.engine_inertia_kg_m2 + CALIBRATION.input_side.hub_inertia_kg_m2
DECELERATION_RAD_S2 = -80.0
SLIP_RAD_S = np.clip(60.0 + DECELERATION_RAD_S2 * T_S, 0.0, None)  # closes after 0.75 s
ASKED_NM = 150.0


def series(value: FloatArray | float) -> Series:
    return Series(
        t_ns=START_NS + ROWS * STEP_NS,
        sequence=ROWS.astype(np.int64),
        value=np.broadcast_to(np.asarray(value, np.float64), ROWS.shape).copy(),
    )


def shift(ratio: float = 0.9, *, to_gear: int = 2, sign: float = 1.0) -> Event:
    """Return a shift whose clutch carries ``ratio`` of what it is asked for."""
    engine_nm = sign * (ratio * ASKED_NM + INERTIA_KG_M2 * DECELERATION_RAD_S2)
    return Event(
        number=1,
        from_gear=1,
        to_gear=to_gear,
        start_ns=START_NS,
        end_ns=START_NS + 1_000_000_000,
        end_reason=EndReason.COMPLETE,
        bad_frame_count=0,
        columns={
            Signal.ENGINE_SPEED: series(300.0 + sign * SLIP_RAD_S),
            Signal.INPUT_SPEED: series(300.0),
            Signal.ENGINE_TORQUE: series(engine_nm),
            Signal.CLUTCH1_TORQUE_COMMAND: series(0.0),
            Signal.CLUTCH2_TORQUE_COMMAND: series(ASKED_NM),
        },
    )


def test_time_and_slip() -> None:
    found = measure(shift(), CALIBRATION)
    assert found.shift_time_s == 1.0
    assert found.peak_slip_rad_s == pytest.approx(60.0, abs=0.3)  # the engine's speed is that of half a segment before
    assert found.slip_duration_s == pytest.approx(55.0 / 80.0, abs=0.01)
    assert found.slip_angle_rad == pytest.approx(0.5 * 60.0 * 0.75, rel=0.01)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("ratio", [1.0, 0.8])
def test_torque_capacity_is_transmitted_over_asked(ratio: float, sign: float) -> None:
    found = measure(shift(ratio, sign=sign), CALIBRATION)
    assert found.torque_capacity_ratio == pytest.approx(ratio, abs=0.01)
    assert found.std_torque_capacity_ratio is not None
    assert 0.03 < found.std_torque_capacity_ratio < 0.1  # gain 3 %, offset 5 Nm, inertia 20 % of 16 Nm


def test_a_clutch_that_seems_to_turn_against_its_slip_has_no_capacity() -> None:
    found = measure(shift(-0.8), CALIBRATION)
    assert found.torque_capacity_ratio is None
    assert found.not_measured["torque_capacity_ratio"] == "untrusted"
    small = measure(shift(-0.01), CALIBRATION)  # nothing, within its deviations
    assert small.torque_capacity_ratio == pytest.approx(-0.01, abs=0.01)
