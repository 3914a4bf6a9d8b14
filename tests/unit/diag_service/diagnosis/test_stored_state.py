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
from diag_service.diagnosis.condition.condition import ConditionMemory, judge
from diag_service.diagnosis.friction import Posterior

CALIBRATION = nominal_calibration()
GOLDEN = Path(__file__).parents[3] / "golden"


def kept(version: int) -> dict[str, Any]:
    table: dict[str, Any] = json.loads((GOLDEN / f"vehicle-state-v{version}.json").read_text(encoding="utf-8"))
    return table


@pytest.fixture
def stored() -> dict[str, Any]:
    return kept(4)


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
