"""The fleet database on SQLite and PostgreSQL: one table whatever the order, and what the views make of it."""

from datetime import timedelta

import pytest
from sqlalchemy import Engine, select

from clutch_results.records import Condition
from fleet_backend import queries
from fleet_backend.choices import Pace, TrendAxis
from fleet_backend.database import transaction
from fleet_backend.errors import RowRefusedError
from fleet_backend.ingest import Worker
from fleet_backend.intake import MessageKind
from fleet_backend.rows import Row, controller_row, status_row
from fleet_backend.schema import SHIFT_RESULT
from fleet_backend.writer import Batch, Writer, identity_of
from fleet_tests.test_ingest import Records, outcomes
from tests.support.fleet import NOW, START, fleet_result, message_of, row_of
from workshop.tester.polling import ControllerReport
from workshop.tester.trouble import TroubleCode

WORN = Condition.CHANGE_FLUID


@pytest.mark.parametrize("is_reversed", [False, True])
@pytest.mark.parametrize("is_together", [False, True])
def test_of_two_contents_under_one_key_the_first_stays(engine: Engine, is_reversed: bool, is_together: bool) -> None:
    rows = [row_of(fleet_result(1)), row_of(fleet_result(1, condition=WORN))][:: -1 if is_reversed else 1]
    told = [rows, rows] if is_together else [[one] for one in (*rows, *rows)]
    aside = [Writer(engine).store(Batch(shifts=some)) for some in told]
    (record,) = queries.worst_first(engine)
    assert record["condition"] == rows[0]["condition"]
    other = {identity_of(rows[1])}
    assert aside == ([other, other] if is_together else [set(), other, set(), other])


@pytest.mark.parametrize("is_reversed", [False, True])
@pytest.mark.parametrize("is_together", [False, True])
def test_one_key_with_two_times_of_making_is_one_row(engine: Engine, is_reversed: bool, is_together: bool) -> None:
    """A store that was put back to an earlier state uses its positions again, in another month."""
    rows = [row_of(fleet_result(1, produced_at=f"2026-0{month}-01T00:00:00.000000Z")) for month in (2, 3)]
    Writer(engine).store(Batch(shifts=[row_of(fleet_result(2)), row_of(fleet_result(2, stream="stream-0"))]))
    told = rows[::-1] if is_reversed else rows
    aside = [Writer(engine).store(Batch(shifts=some)) for some in ((told,) if is_together else ([one] for one in told))]
    assert aside[-1] == {identity_of(told[1])}
    with transaction(engine) as connection:
        found = connection.execute(select(SHIFT_RESULT.c.produced_at).where(SHIFT_RESULT.c.seq == 1)).scalars().all()
    assert found == [told[0]["produced_at"]]
    assert queries.result_count(engine) == 3


def test_the_running_condition_is_that_of_the_last_shift_of_the_newest_stream(engine: Engine) -> None:
    old = [row_of(fleet_result(seq, condition=WORN)) for seq in (1, 2)]
    undated = {"start_bus_ns": 1, "end_bus_ns": 2}  # the bus has no date: it is ranked by when it was analysed
    new = [
        row_of(
            fleet_result(1, stream="stream-0", produced_at="2026-02-01T00:00:00.000000Z", condition=Condition.WATCH)
        ),
        row_of(fleet_result(2, stream="stream-0", produced_at="2026-01-31T00:00:00.000000Z")),  # the clock jumped
    ]
    for row in (new[1] | undated, old[1], new[0] | undated, old[0]):
        Writer(engine).store(Batch(shifts=[row]))
    (record,) = queries.worst_first(engine)
    assert (record["stream"], record["seq"], record["condition"]) == ("stream-0", 2, "good")
    order = [(row["stream"], row["seq"]) for row in queries.trend(engine, "car1", 2, TrendAxis.SHIFT)]
    assert order == [("stream-1", 1), ("stream-1", 2), ("stream-0", 1), ("stream-0", 2)]


def test_the_worst_comes_first_with_its_interval(engine: Engine) -> None:
    conditions = {"a": Condition.GOOD, "b": WORN, "c": Condition.WATCH, "d": Condition.NO_VERDICT}
    rows = [row_of(fleet_result(1, vehicle=name, condition=condition)) for name, condition in conditions.items()]
    Writer(engine).store(Batch(shifts=rows))
    records = queries.worst_first(engine)
    assert [record["vehicle"] for record in records] == ["b", "c", "a", "d"]
    assert records[0]["mu_c_low"] == pytest.approx(0.1361 - 2 * 0.0012)
    assert records[0]["slope_high_s_rad"] == pytest.approx(0.0021 + 2 * 0.0003)
    assert len(queries.worst_first(engine, limit=1)) == 1


def test_a_trend_has_three_axes_and_knows_the_fluid(engine: Engine) -> None:
    Writer(engine).store(Batch(shifts=[row_of(fleet_result(seq)) for seq in range(1, 6)]))
    queries.note_fill(engine, "car1", "old oil", at=START - timedelta(days=1), odometer_m=None, note=None)
    queries.note_fill(engine, "car1", "new oil", at=START + timedelta(seconds=10), odometer_m=5.0, note="at last")
    for axis in TrendAxis:
        records = queries.trend(engine, "car1", 2, axis)
        assert [record["shift_number"] for record in records] == [1, 2, 3, 4, 5]
    assert [record["fluid"] for record in records] == ["old oil"] * 3 + ["new oil"] * 2
    assert records[0]["covariance_mu_c_mu_s"] == pytest.approx(0.4 * 0.0012 * 0.0016)
    assert queries.trend(engine, "car1", 1, TrendAxis.SHIFT) == []


def status(moment: str, word: str) -> Row:
    data = {"vehicle": "car1", "status": word, "connected_at": moment, "service_version": "1"}
    return status_row({**data, "algorithm_version": "a", "calibration_version": "c"})


def controller(read_at: str, *codes: TroubleCode, vehicle: str = "car1") -> Row:
    report = ControllerReport(
        vehicle=vehicle, read_at=read_at, controller="7E1 (answers 7E9)", description="TCU", codes=codes
    )
    return controller_row(report.record)


def test_the_latest_word_of_a_controller_stays_and_is_told_code_by_code(engine: Engine) -> None:
    pending, confirmed = (TroubleCode(number=0x089700, status=status, text="worn") for status in (0x04, 0x08))
    other = TroubleCode(number=0x021800, status=0x08, text="hot")
    rows = [
        controller("2026-01-02T00:00:00.000000Z", confirmed, other),
        controller("2026-01-01T00:00:00.000000Z", pending),
        controller("2026-01-01T00:00:00.000000Z", vehicle="car2"),
    ]
    for row in rows:
        Writer(engine).store(Batch(controllers=[row]))
    told = queries.trouble_codes(engine)
    assert [(one["vehicle"], one["code"], one["states"]) for one in told] == [
        ("car1", "P0897", ["confirmed"]),
        ("car1", "P0218", ["confirmed"]),
        ("car2", None, None),
    ]
    assert told[0]["read_at"] == START + timedelta(days=1)


def test_a_row_that_does_not_fit_takes_the_whole_batch_back(engine: Engine) -> None:
    wrong = {**row_of(fleet_result(2)), "status": None}
    with pytest.raises(RowRefusedError):
        Writer(engine).store(Batch(shifts=[row_of(fleet_result(1)), wrong]))
    assert queries.result_count(engine) == 0


async def test_another_result_of_a_key_is_put_aside_with_a_reason(engine: Engine) -> None:
    records = Records()
    worker = Worker(records.connect, Writer(engine), name="worker-1", now=lambda: NOW, pace=Pace())
    first, second = (message_of(fleet_result(1, condition=one)) for one in (Condition.GOOD, Condition.CHANGE_FLUID))
    for _ in range(2):
        await worker.process(records, [first, second])
    assert outcomes(records) == 2 * [("car1", 1, "accepted"), ("car1", 1, "quarantined")]
    assert worker.counts == {MessageKind.SHIFT: 2, MessageKind.POISON: 2}
    (aside,) = queries.quarantined(engine, 9)
    (kept,) = queries.worst_first(engine)
    assert (aside["reason"], kept["condition"]) == ("conflict", "good")
    assert "another result of this key" in str(aside["detail"])
