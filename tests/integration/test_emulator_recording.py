"""Whole drives through plant, sensors and frame builder."""

import numpy as np
import pytest

from canlog.e2e.message_contract import message_contracts
from canlog.e2e.profile1 import COUNTER_PERIOD, counter_of, crc_is_valid, data_id_remainder
from dbc.contract import load_contract
from ecu_emulator.bus.frames import EncodedFrames
from ecu_emulator.drive.build import ROAD_MESSAGES
from ecu_emulator.drive.recording import Drive, frames_of
from ecu_emulator.truth import TruthLog
from tests.support.builders import drive_scenario


@pytest.fixture(scope="module")
def recorded() -> tuple[EncodedFrames, TruthLog]:
    return frames_of(drive_scenario("noise_only"))


def test_every_message_keeps_its_cycle_and_its_protection(recorded: tuple[EncodedFrames, TruthLog]) -> None:
    frames, truth = recorded
    assert truth.totals is not None
    assert np.all(np.diff(frames.t_s) >= 0.0)
    contracts = {name: one for name, one in message_contracts(load_contract()).items() if name not in ROAD_MESSAGES}
    assert set(frames.can_id.tolist()) == {contract.can_id for contract in contracts.values()}
    for contract in contracts.values():
        rows = np.flatnonzero(frames.can_id == contract.can_id)
        t_ms = np.rint(1000.0 * frames.t_s[rows])
        expected_ms = np.arange(contract.phase_ms, 1000.0 * truth.totals.duration_s + 0.5, contract.cycle_ms)
        assert np.array_equal(t_ms, expected_ms), contract.name
        assert contract.data_id is not None
        assert crc_is_valid(frames.data[rows], data_id_remainder(contract.data_id)).all()
        assert np.array_equal(counter_of(frames.data[rows]), np.arange(rows.size) % COUNTER_PERIOD)


def test_a_controller_that_starts_says_not_available() -> None:
    scenario = drive_scenario("ideal")
    first = next(iter(Drive(scenario).stretches(1.0))).frames
    database = load_contract()
    for contract in message_contracts(database).values():
        start_s = scenario.startup.by_sender()[contract.sender]
        signals = [database.get_message_by_name(contract.name).get_signal_by_name(name) for name in contract.signals]
        assert start_s > 0.0
        for row in np.flatnonzero(first.can_id == contract.can_id):
            word = int.from_bytes(first.data[row].tobytes(), "little")
            codes = [(word >> signal.start) % (1 << signal.length) for signal in signals]
            is_missing = {code == (1 << signal.length) - 1 for code, signal in zip(codes, signals, strict=True)}
            assert is_missing == {bool(first.t_s[row] < start_s)}, (contract.name, first.t_s[row])


def test_the_truth_reaches_the_bus_only_through_what_sensors_see() -> None:
    """While no clutch slips, vehicles that differ in friction only send the same bytes."""
    fresh, aged = (
        next(iter(Drive(drive_scenario("noise_only", fluid=fluid)).stretches(1.2))).frames
        for fluid in ("ideal", "case2")
    )
    assert len(fresh) > 700
    assert np.array_equal(fresh.t_s, aged.t_s)
    assert np.array_equal(fresh.data, aged.data)
