"""A running state that an earlier program stored is taken up as it is: names in the code may change, stored ones not.

``vehicle-state-v3.json`` was written by commit a65d50d: fifteen shifts onto each clutch with new fluid, a baseline of
both, and then three shifts with worn fluid that contradict the state.
"""

import json
from pathlib import Path
from typing import Any

import pytest

from clutch_model.calibration import nominal_calibration
from diag_service.diagnosis.condition.condition import ConditionMemory, Fit, judge
from diag_service.diagnosis.friction import FilterState

CALIBRATION = nominal_calibration()
STORED_PATH = Path(__file__).parents[3] / "golden" / "vehicle-state-v3.json"


@pytest.fixture
def stored() -> dict[str, Any]:
    table: dict[str, Any] = json.loads(STORED_PATH.read_text(encoding="utf-8"))
    return table


def test_a_stored_filter_state_survives_to_the_last_digit(stored: dict[str, Any]) -> None:
    state = FilterState.from_json(stored["belief"], CALIBRATION)
    assert state.to_json() == stored["belief"]
    assert (state.shift_counts, state.refused_counts) == ((15, 15), (1, 2))
    assert [one is not None and one.shift_count for one in state.baselines] == [15, 15]


def test_a_stored_memory_survives_with_its_fits(stored: dict[str, Any]) -> None:
    memory = ConditionMemory.from_json(stored["condition"])
    assert memory.to_json() == stored["condition"]
    assert memory.fits == (Fit.AGREES,) * 17 + (Fit.CONTRADICTS,) * 3
    assert all(scatter is not None for scatter in memory.scatters)


def test_the_verdict_on_a_stored_state_is_what_it_was(stored: dict[str, Any]) -> None:
    state = FilterState.from_json(stored["belief"], CALIBRATION)
    _, verdict = judge(ConditionMemory.from_json(stored["condition"]), state, stored["clutch"], CALIBRATION)
    assert verdict.friction is not None
    assert {
        "condition": verdict.condition.name,
        "reason": verdict.reason,
        "mu_c": verdict.friction.mu_c,
        "mu_s": verdict.friction.mu_s,
    } == stored["verdict"]
