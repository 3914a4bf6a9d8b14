"""A running state that an earlier program stored is taken up as it is: names in the code may change, stored ones not.

``vehicle-state-v4.json`` holds the first state of the joint posterior: thirty shifts onto each clutch with new fluid, a
baseline of both, and then two shifts with worn fluid that contradict them. ``vehicle-state-v3.json`` was written by
commit a65d50d, in a format that cannot be taken over.
"""

import json
from pathlib import Path
from typing import Any

import pytest

from clutch_model.calibration import nominal_calibration
from diag_service.diagnosis.condition.condition import ConditionMemory, Fit, judge
from diag_service.diagnosis.friction import Posterior

CALIBRATION = nominal_calibration()
GOLDEN = Path(__file__).parents[3] / "golden"


def kept(version: int) -> dict[str, Any]:
    table: dict[str, Any] = json.loads((GOLDEN / f"vehicle-state-v{version}.json").read_text(encoding="utf-8"))
    return table


@pytest.fixture
def stored() -> dict[str, Any]:
    return kept(4)


def test_a_stored_posterior_survives_to_the_last_digit(stored: dict[str, Any]) -> None:
    state = Posterior.from_json(stored["posterior"], CALIBRATION)
    unknown = {"apart": 0.0, "apart_by_chance": 0.0}  # by programs that did not count it
    assert json.loads(json.dumps(state.to_json())) == stored["posterior"] | unknown
    assert state.shift_counts == (30, 30)
    assert state.is_used == (True,) * 10 + (False,) * 2
    assert [one is not None and one.shift_count for one in state.baselines] == [15, 15]


def test_a_stored_memory_survives_with_its_fits(stored: dict[str, Any]) -> None:
    memory = ConditionMemory.from_json(stored["condition"])
    assert memory.to_json() == stored["condition"]
    assert memory.fits == (Fit.AGREES,) * 18 + (Fit.CONTRADICTS,) * 2
    assert all(scatter is not None for scatter in memory.scatters)


def test_the_verdict_on_a_stored_state_is_what_it_was(stored: dict[str, Any]) -> None:
    state = Posterior.from_json(stored["posterior"], CALIBRATION)
    _, verdict = judge(ConditionMemory.from_json(stored["condition"]), state, stored["clutch"], CALIBRATION)
    assert verdict.friction is not None
    before = stored["verdict"]
    assert (verdict.condition.name, verdict.reason) == (before["condition"], before["reason"])
    assert verdict.friction.mu_c == pytest.approx(before["mu_c"], rel=1e-9)
    assert verdict.friction.mu_s == pytest.approx(before["mu_s"], rel=1e-9)


def test_a_state_of_the_format_before_is_refused_and_its_memory_is_read() -> None:
    before = kept(3)
    with pytest.raises(ValueError, match="running state of format 3, expected 4"):
        Posterior.from_json(before["belief"], CALIBRATION)
    assert ConditionMemory.from_json(before["condition"]).to_json() == before["condition"]
