"""The messages that driving added: logs and databases from before them mean what they meant."""

import lzma
from pathlib import Path

import numpy as np
import pytest

import canlog
from dbc.contract import DBC_PATH, load_contract
from ecu_emulator.driving.states import DriveState, EngineState
from ecu_emulator.recording import ROAD_MESSAGES
from tests.golden.analyses import RECORDINGS

BEFORE = Path(__file__).parents[1] / "data" / "dct-before-driving.dbc"
RECORDED_BEFORE = "ideal"
NOT_AVAILABLE = 15


@pytest.fixture(name="earlier_log")
def _earlier_log(tmp_path: Path) -> Path:
    path = tmp_path / "earlier.log"
    path.write_bytes(lzma.decompress((RECORDINGS / f"{RECORDED_BEFORE}.log.xz").read_bytes()))
    return path


def signals(log: Path, database: Path) -> dict[str, canlog.Samples]:
    return canlog.read(log, database).signals()


def assert_same(before: dict[str, canlog.Samples], now: dict[str, canlog.Samples]) -> None:
    assert len(before) > 40
    for name, samples in before.items():
        np.testing.assert_array_equal(samples.t_ns, now[name].t_ns)
        np.testing.assert_array_equal(samples.value, now[name].value)
        assert samples.unit == now[name].unit


def test_what_was_there_is_where_it_was() -> None:
    before, now = canlog.load_database(BEFORE), load_contract()
    assert {message.name for message in now.messages} - {message.name for message in before.messages} == ROAD_MESSAGES
    for message in before.messages:
        same = now.get_message_by_name(message.name)
        assert (same.frame_id, same.length, same.cycle_time) == (message.frame_id, message.length, message.cycle_time)
        assert repr(same.signals) == repr(message.signals)


def test_a_log_from_before_decodes_as_it_did(earlier_log: Path) -> None:
    before, now = signals(earlier_log, BEFORE), signals(earlier_log, DBC_PATH)
    assert now.keys() == before.keys()
    assert_same(before, now)


def test_the_shift_cycle_sends_what_it_always_sent(cycle_log: Path) -> None:
    assert signals(cycle_log, DBC_PATH).keys() == signals(cycle_log, BEFORE).keys()


@pytest.mark.parametrize(("signal", "states"), [("DriveState", DriveState), ("EngineState", EngineState)])
def test_the_database_names_every_state(signal: str, states: type[DriveState] | type[EngineState]) -> None:
    (found,) = (one for message in load_contract().messages for one in message.signals if one.name == signal)
    assert found.choices is not None
    named = {number: str(name) for number, name in found.choices.items() if number != NOT_AVAILABLE}
    assert named == {state.value: state.name.title().replace("_", "") for state in states}
