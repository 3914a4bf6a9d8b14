"""The table of faults and codes says what the controller stores: each fault is set while a car drives."""

from collections.abc import Iterator, Mapping, Sequence

import pytest

from dbc.contract import load_contract
from ecu_emulator.bus.sent_values import SentValues
from ecu_emulator.drive.recording import Drive
from ecu_emulator.scenario.scenario_file import load_scenario, parse_fault
from tests.tools.uds_tables import page
from workshop.controller.controller import Controller
from workshop.controller.monitoring import MONITOR_PERIOD_S, Monitoring
from workshop.controller.monitors import SENSED
from workshop.controller.table import shipped_table

BEGIN_S = 2.0  # in 1st gear, once all messages have been sent
END_S = 41.0  # of a cycle through all gears
MORE = {"P2787": {"P0218"}, "P0868": {"P0780"}}  # codes to which the faults of a code lead besides
TABLE = shipped_table()
Faults = Sequence[Mapping[str, object]]


def codes_by_faults() -> list[tuple[Faults, set[str]]]:
    groups: dict[str, tuple[Faults, set[str]]] = {}
    for trouble in TABLE.troubles.values():
        if trouble.faults:
            groups.setdefault(str(trouble.faults), (trouble.faults, set()))[1].add(trouble.code)
    return list(groups.values())


def stored_codes(faults: Faults) -> Iterator[set[str]]:
    """Yield the codes that the controller has stored, ten times a second from the faults on."""
    now_s = [0.0]
    sent = SentValues(load_contract("nominal"), lambda: now_s[0])
    controller = Controller(
        TABLE, values=lambda: {**sent.now({}), **sent.silences}, clock=lambda: now_s[0], chance=bytes
    )
    monitoring, drive = Monitoring(controller), Drive(load_scenario("ideal"))
    for number, stretch in enumerate(drive.stretches(MONITOR_PERIOD_S)):
        frames = stretch.frames
        latest = dict(zip(frames.can_id.tolist(), range(len(frames.t_s)), strict=True))  # of each message
        for can_id, row in latest.items():
            sent.note(can_id, frames.data[row].tobytes(), float(frames.t_s[row]))
        now_s[0] = stretch.end_s
        if sent.has_all(SENSED):
            monitoring.judge({**sent.now({}), **sent.silences}, now_s[0])
        if number == round(BEGIN_S / MONITOR_PERIOD_S):
            for fault in faults:
                drive.add_fault(parse_fault(fault))
        records = controller.state.memory.records
        yield {TABLE.troubles[number].code for number, record in records.items() if record.has_data}
        if now_s[0] > END_S:
            return


@pytest.mark.parametrize(("faults", "codes"), codes_by_faults(), ids=lambda value: "-".join(sorted(map(str, value))))
def test_the_controller_stores_the_codes_that_the_table_says(faults: Faults, codes: set[str]) -> None:
    allowed = codes.union(*(MORE.get(code, set()) for code in codes))
    for stored in stored_codes(faults):
        assert stored <= allowed
        if stored >= codes:
            return
    raise AssertionError(f"{codes - stored} not stored")


def test_the_page_of_tables_lists_faults_and_codes() -> None:
    text = page(TABLE)
    assert "| quantity clutch1_pressure_pa, kind not_available | P0841 |" in text
    assert "| kind restart, message ECM_TorqueSpeed | U0100 |" in text
