"""A day of the car in tests/tools/uds_ageing.py: what it tells, what it keeps, and how that is read."""

import json
from pathlib import Path

import pytest

from ecu_emulator.diagnostics.clutches import SHIFT_SCHEMA
from ecu_emulator.diagnostics.memory_file import MemoryFile
from ecu_emulator.diagnostics.table_file import shipped_table
from tests.support.traffic import START_NS
from tests.support.uds.ageing_car import Car, Plan
from tests.tools.uds_ageing import Started, deviations, is_possible, snapshot_of

FRICTION = {"mu_c": 0.118, "std_mu_c": 0.002, "mu_s": 0.125, "std_mu_s": 0.003}


def line(condition: str, end_s: int) -> str:
    verdict = {"clutch": 1, "condition": condition, "friction": FRICTION}
    end_ns = START_NS + end_s * 1_000_000_000
    return json.dumps({"schema": SHIFT_SCHEMA, "end_bus_ns": end_ns, "verdict": verdict}) + "\n"


def test_a_day_with_worn_fluid_is_told_step_by_step_and_kept(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = tmp_path / "lines"
    lines.write_text(line("good", 4) + line("change_fluid", 12), encoding="ascii")
    plan = Plan(
        folder=str(tmp_path), fluid="case2", vehicle_seed=1, drive_seed=1, cycles=1, start_ns=START_NS, lines=str(lines)
    )  # fmt: skip
    with MemoryFile(plan.memory, shipped_table()) as store:
        Car(plan, store).live()
    steps = [json.loads(told) for told in capsys.readouterr().out.splitlines()]
    assert [step["step"] for step in steps] == ["started", "tested", "driving", "tested", "ended"]
    assert [step["worn"] for step in steps] == [0x50, 0x00, 0x00, 0x27, 0x27]
    with Started(plan.memory) as controller:
        rows = list(deviations(snapshot_of(controller), {"1": [0.117, 0.128], "2": [0.14, 0.15]}))
    assert [row[1:] for row in rows[:2]] == [pytest.approx((0.118, 0.002, 0.117)), pytest.approx((0.125, 0.003, 0.128))]
    assert all(value != value for _, value, _, _ in rows[2:])  # noqa: PLR0124 - not a number: not known


@pytest.mark.parametrize(
    ("found", "before", "after", "expected"),
    [
        (["P0897"], [], ["P0897"], True),
        ([], [], ["P0897"], True),
        (["P0810"], ["P0897", "P0810"], [], True),  # the cycle was good for one, and not yet for the other
        ([], ["P0897"], ["P0897"], False),  # lost
        (["P0218"], ["P0897"], [], False),  # invented
    ],
)
def test_a_kill_leaves_each_code_as_before_or_as_after(
    found: list[str], before: list[str], after: list[str], expected: bool
) -> None:
    assert is_possible(found, before, after) is expected
