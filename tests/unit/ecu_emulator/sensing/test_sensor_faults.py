"""Scripted sensor faults: what each kind does to the readings, when, and how many of them."""

import math

import numpy as np
import pytest

from canlog.arrays import FloatArray
from ecu_emulator.plant.state import Col
from ecu_emulator.scenario.faults import Phase, SensorFault, SensorFaultKind
from ecu_emulator.sensing import SensorFaults
from ecu_emulator.shift_control import tcu_data
from tests.unit.ecu_emulator.rows import made_up_rows, with_shift

QUANTITY = "hub_speed_rad_s"
SEND_MS = np.arange(0, 1000, 10)
READING = 100.0 + np.sin(SEND_MS / 30.0)


def fault(kind: str, **changes: float | str) -> SensorFault:
    return SensorFault(**{"quantity": QUANTITY, "kind": SensorFaultKind(kind), **changes})  # type: ignore[arg-type]


def applied(*faults: SensorFault, quantity: str = QUANTITY) -> tuple[FloatArray, tuple[int, ...]]:
    stage = SensorFaults(faults)
    return stage.applied(quantity, SEND_MS, READING), tuple(stage.changed_counts)


def test_an_offset_lasts_from_its_start_to_its_end() -> None:
    wrong, counts = applied(fault("offset", size=5.0, start_s=0.2, duration_s=0.3))
    expected = np.where((SEND_MS >= 200) & (SEND_MS < 500), 5.0, 0.0)
    assert wrong - READING == pytest.approx(expected)
    assert counts == (30,)


def test_a_frozen_sensor_repeats_what_it_read_before() -> None:
    wrong, counts = applied(fault("frozen", start_s=0.205, duration_s=0.1))
    assert np.all(wrong[21:31] == READING[20])
    assert np.array_equal(np.delete(wrong, np.s_[21:31]), np.delete(READING, np.s_[21:31]))
    assert counts == (10,)


def rows_with_shifts() -> FloatArray:
    """Return 900 ms with a shift at 100 ms and another at 500 ms, each phase 50 ms long."""
    rows = made_up_rows(900)
    rows[:, Col.SHIFT_PHASE] = tcu_data.HOLD
    for gear, start_ms in enumerate((100, 500), start=1):
        rows = with_shift(rows, start_ms, start_ms + 200, gear, gear + 1)
        for step, phase in enumerate((tcu_data.PREFILL, tcu_data.TORQUE, tcu_data.INERTIA, tcu_data.LOCK_UP)):
            rows[start_ms + 50 * step : start_ms + 50 * step + 50, Col.SHIFT_PHASE] = phase
    return rows


@pytest.mark.parametrize(
    ("shift", "phase", "start_s", "begins_s"),
    [(1, Phase.PREFILL, 0.0, 0.1), (1, Phase.LOCK_UP, 0.0, 0.25), (2, Phase.INERTIA, 0.02, 0.62)],
)
@pytest.mark.parametrize("chunk", [900, 100, 37])
def test_a_fault_can_be_timed_by_a_shift(shift: int, phase: Phase, start_s: float, begins_s: float, chunk: int) -> None:
    stage = SensorFaults([fault("offset", size=1.0, shift=shift, phase=phase, start_s=start_s, duration_s=0.1)])
    rows, wrong = rows_with_shifts(), []
    for first_ms in range(0, len(rows), chunk):
        stage.feed(rows[first_ms : first_ms + chunk], first_ms)
        inside = slice(*np.searchsorted(SEND_MS, (first_ms, min(first_ms + chunk, len(rows)))).tolist())
        send_ms = SEND_MS[inside]
        wrong.append(stage.applied(QUANTITY, send_ms, np.zeros(len(send_ms))))
    (span_s,) = stage.spans_s
    assert span_s == pytest.approx((begins_s, begins_s + 0.1))
    assert SEND_MS[np.flatnonzero(np.concatenate(wrong))[0]] / 1000.0 == pytest.approx(math.ceil(begins_s * 100) / 100)
    assert stage.changed_counts == [10]
