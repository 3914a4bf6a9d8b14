"""What is believed is one record: a conclusion is made from it and changes nothing of it."""

from dataclasses import replace
from functools import cache

import pytest

from clutch_model.calibration import nominal_calibration, shipped_calibration
from dbc.contract import load_contract
from diag_service.diagnosis.events import Event
from diag_service.errors import ConfigError
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from diag_service.service.stages import Belief, DualClutch, LockupClutch, Stages, kind_of
from ecu_emulator.drive.recording import Drive
from tests.support.builders import drive_scenario
from tests.support.wire import received

CALIBRATION = nominal_calibration()
FILLED_AT = "2026-01-01T00:00:00.000000Z"


def new_stages() -> Stages:
    return Stages(Decoder(load_contract(), load_profile()), CALIBRATION)


@cache
def shifts() -> tuple[Event, ...]:
    return tuple(new_stages().segment(received(next(Drive(drive_scenario()).stretches(10.0)).frames)))


def test_a_conclusion_changes_nothing_of_what_was_believed() -> None:
    element, before = new_stages().element, Belief.fresh(CALIBRATION)
    stored = before.to_json()
    once, again = (element.conclude(before, shifts()[0]) for _ in range(2))
    assert (once.estimate, once.verdict, once.belief.to_json()) == (
        again.estimate,
        again.verdict,
        again.belief.to_json(),
    )
    assert once.belief.since_ns == shifts()[0].start_ns
    assert before.to_json() == stored != once.belief.to_json()


def test_an_event_of_the_fluid_before_is_judged_by_itself() -> None:
    stages = new_stages()
    first = stages.conclude(shifts()[0])
    stages.note_fluid(FILLED_AT)
    filled = stages.belief
    past = stages.conclude_of_earlier_fluid(shifts()[0])
    assert past.estimate.friction is not None
    assert first.estimate.friction is not None
    assert past.verdict.shift_count == first.verdict.shift_count == 1
    assert stages.belief.to_json() == past.belief.to_json() == filled.to_json()
    assert filled.memory.fluid_since == FILLED_AT


def test_each_kind_of_transmission_has_its_element_and_no_other_state() -> None:
    lockup = shipped_calibration("lockup")
    assert (kind_of(CALIBRATION), kind_of(lockup)) == (DualClutch, LockupClutch)
    pair, single = Belief.fresh(CALIBRATION), Belief.fresh(lockup)
    with pytest.raises(ConfigError):
        _ = pair.lockup
    with pytest.raises(ConfigError):
        _ = single.posterior
    assert replace(single, since_ns=7).to_json()[1]["running_since_ns"] == 7
