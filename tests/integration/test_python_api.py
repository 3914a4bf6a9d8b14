"""``diag_service`` and ``ecu_emulator`` from Python: the same numbers as the programs, and no side effects."""

import asyncio
import logging
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

import can
import polars as pl
import pytest

import diag_service
import ecu_emulator
from diag_service.api.live import LiveDiagnosis
from diag_service.batch.drives import drive_of
from diag_service.batch.tables import write_results
from diag_service.batch.worker import Analyst
from diag_service.settings.options import MeaningOptions, diagnosis_config
from tests.plugins.drives import SHIFT_COUNT, send_time_s
from tests.support.in_process import ended, never_a_program
from tests.support.patience import HANG_S

_CHANNELS = iter(range(1_000_000))


@contextmanager
def virtual_bus() -> Iterator[tuple[can.BusABC, can.BusABC]]:
    """Yield two ends of a bus; frames keep the times that they are sent with."""
    channel = f"api-{next(_CHANNELS)}"
    with (
        can.Bus(channel, interface="virtual", preserve_timestamps=True) as near,
        can.Bus(channel, interface="virtual") as far,
    ):
        yield near, far


def messages(log: Path) -> list[can.Message]:
    lines = log.read_bytes().splitlines()
    found = []
    for line in lines:
        identifier, payload = line.split()[2].decode("ascii").split("#")
        found.append(
            can.Message(
                timestamp=send_time_s(line), arbitration_id=int(identifier, 16), data=bytes.fromhex(payload),
                is_extended_id=False,
            )
        )  # fmt: skip
    return found


@pytest.fixture(autouse=True)
def _as_a_library() -> Iterator[None]:
    with never_a_program():
        yield


def process_state() -> dict[str, object]:
    """Return what a library must leave alone."""
    loggers = [logging.getLogger(name) for name in ("", "can", "asyncio")]
    return {
        "signals": [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1)],
        "loggers": [(logger.level, logger.handlers[:], logger.propagate) for logger in loggers],
        "levels": [logging.getLogger(name).level for name in ("diag_service", "canlog", "ecu_emulator")],
        "asammdf": sys.modules.get("asammdf", "not loaded"),
        "threads": {thread.name for thread in threading.enumerate() if "live" in thread.name},
    }


def test_it_is_what_json_prints_and_disturbs_nothing(
    drive_log: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = process_state()
    capsys.readouterr()
    analysis = diag_service.analyze(drive_log, vehicle="car7")
    assert capsys.readouterr() == ("", "")
    assert process_state() == before
    assert analysis.to_json() == ended("analyze", drive_log, "--vehicle", "car7", "--json").out
    assert len(analysis.results) == SHIFT_COUNT
    assert analysis.is_complete
    assert analysis.vehicle == "car7"
    assert sorted(analysis.verdicts) == [1, 2]
    assert analysis.verdicts[2] == analysis.results[-1].verdict
    assert analysis.frames["decoded"] == analysis.summary["frames"]["decoded"] > 0
    assert repr(analysis).startswith(f"<diag_service.Analysis of {drive_log}: {SHIFT_COUNT} shifts, clutch 1 ")
    shown = analysis._repr_html_()
    assert str(drive_log) in shown
    assert [shown.lower().count(f"<p>{analysis.order.lower()}</p>")] == [1]
    page = tmp_path / "report.html"
    diag_service.write_report(drive_log, page)
    (chart,) = re.findall(r"<svg .*?</svg>", shown)
    assert chart in page.read_text(encoding="utf-8")
    by_clutch = {row["clutch"]: row for row in analysis.clutches}
    assert [by_clutch[clutch]["shift_count"] for clutch in (1, 2)] == [
        analysis.verdicts[clutch].shift_count for clutch in (1, 2)
    ]


def test_the_table_is_the_one_that_is_written(drive_log: Path, tmp_path: Path) -> None:
    output = tmp_path / "results.parquet"
    config = diagnosis_config(MeaningOptions())
    write_results(output, [Analyst(config).analyse(drive_of([drive_log]))])  # as a process of a folder run does
    assert diag_service.analyze(drive_log).shifts.to_polars().to_dicts() == pl.read_parquet(output).to_dicts()


def test_a_part_of_a_drive_is_told_as_such(drive_log: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.log"
    cut.write_bytes(drive_log.read_bytes()[:-9])
    analysis = diag_service.analyze(cut)
    assert not analysis.is_complete
    assert {verdict.condition.name for verdict in analysis.verdicts.values()} == {"NO_VERDICT"}
    assert set(analysis.shifts.column("verdict.condition")) == {"no_verdict"}
    assert any("is cut off" in notice for notice in analysis.notices)
    with pytest.raises(diag_service.SourceError, match=r"cut\.log"):
        diag_service.analyze(cut, is_strict=True)


def test_importing_it_loads_no_library() -> None:
    program = (
        "import sys, canlog, diag_service, ecu_emulator, ecu_emulator.pytest_plugin, diag_service.pytest_plugin\n"
        "print([name for name in ('numpy', 'numba', 'cantools', 'can', 'click', 'asyncio') if name in sys.modules])\n"
        "print(sorted(diag_service.__all__) == sorted(set(dir(diag_service)) & set(diag_service.__all__)))"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "True"
    loaded = set(done.stdout.splitlines()[0].strip("[]").replace("'", "").split(", ")) - {"", "asyncio"}
    assert loaded == set()


async def until(live: LiveDiagnosis, count: int) -> list[diag_service.ShiftResult]:
    """Return the first results."""
    found: list[diag_service.ShiftResult] = []
    async for result in live:
        found.append(result)
        if len(found) == count:
            live.stop()
    return found


async def test_a_bus_says_what_its_recording_says(drive_log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    recorded = diag_service.analyze(drive_log)
    before = process_state()
    with virtual_bus() as (near, far):
        async with diag_service.diagnose(far, vehicle="car1") as live:
            for message in messages(drive_log):
                near.send(message)
            async with asyncio.timeout(HANG_S):
                results = await until(live, SHIFT_COUNT)
        near.send(can.Message(arbitration_id=1))
        assert far.recv(timeout=HANG_S) is not None  # it is still open
    assert [result.estimate for result in results] == [result.estimate for result in recorded.results]
    analysis = live.analysis
    assert [row["status"] for row in analysis.shifts] == [row["status"] for row in recorded.shifts]
    assert analysis.frames["on_bus"] == len(messages(drive_log))
    assert analysis.frames["decoded"] == recorded.frames["decoded"]
    assert live.left_out_count == 0
    assert process_state() == before
    assert capsys.readouterr() == ("", "")


async def test_leaving_the_loop_or_being_cancelled_ends_it(drive_log: Path) -> None:
    with virtual_bus() as (near, far):
        for message in messages(drive_log):
            near.send(message)
        async with asyncio.timeout(HANG_S), diag_service.diagnose(far) as live:
            async for _ in live:
                break
        assert live.analysis.summary["shifts"]["stored"] >= 1
        with pytest.raises(diag_service.ConfigError, match="iterated over only once"):
            await until(live, 1)
        for is_begun in (False, True):
            quiet = diag_service.diagnose(far)
            waiting = asyncio.create_task(until(quiet, 1))
            await asyncio.sleep(0)
            while is_begun and not quiet.description:  # noqa: ASYNC110 - it offers no event
                await asyncio.sleep(0.01)
            waiting.cancel()
            with pytest.raises(asyncio.CancelledError):
                await waiting
    assert [task for task in asyncio.all_tasks() if task.get_name() == "live diagnosis"] == []


def test_a_program_without_a_loop_listens_in_the_background(drive_log: Path, tmp_path: Path) -> None:
    with virtual_bus() as (near, far):
        live = diag_service.diagnose(far, store=tmp_path / "car.sqlite", duration_s=HANG_S)
        with live.in_background() as heard:
            for message in messages(drive_log):
                near.send(message)
            assert len(heard.wait_for(2, HANG_S)) >= 2
            with pytest.raises(TimeoutError, match=f"{SHIFT_COUNT + 5} were waited for"):
                heard.wait_for(SHIFT_COUNT + 5, 0.05)
        analysis = heard.stop()
        with pytest.raises(TimeoutError, match="the diagnosis has ended with"):
            heard.wait_for(SHIFT_COUNT + 5, HANG_S)
        with pytest.raises(diag_service.StoreError), diag_service.diagnose(far, store=tmp_path).in_background():
            pass
    assert len(analysis.results) >= 2
    assert (tmp_path / "car.sqlite").exists()


def test_an_emulator_records_what_the_program_records(cycle_log: Path, tmp_path: Path) -> None:
    car = ecu_emulator.Emulator()
    with car:
        pass  # what it drove on a bus does not matter to a log
    made = car.record(tmp_path / "cycle.log")
    assert made.path.read_bytes() == cycle_log.read_bytes()
    assert made.truth.read_bytes() == cycle_log.with_name("cycle.log.truth.jsonl").read_bytes()
    assert (made.totals.shifts, made.is_finished) == (10, True)


def test_an_emulator_drives_on_a_bus_of_its_own(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = process_state()
    fault = {"kind": "silence", "message": "TCU_Shift"}
    car = ecu_emulator.Emulator("noise_only", seed=3, faults=[fault], truth=tmp_path / "truth.jsonl")
    with pytest.raises(ecu_emulator.EmulatorConfigError, match="not driving yet"):
        car.add_fault(fault)
    with car, car.open_bus() as bus, can.Bus(**car.bus_arguments) as other:
        first = bus.recv(timeout=HANG_S)
        assert first is not None
        car.wait_until(0.1, HANG_S)
        with pytest.raises(ecu_emulator.EmulatorConfigError, match="not over"):
            _ = car.result
        with pytest.raises(ecu_emulator.EmulatorConfigError, match="quantity"):
            car.add_fault({"quantity": "colour", "kind": "frozen"})
        car.add_fault({"kind": "loss", "share": 0.9})
        car.wait_until(2.6, HANG_S)  # frames are made two seconds ahead
        result = car.stop()
        heard = [first, *iter(lambda: bus.recv(timeout=0.0), None)]
        assert other.recv(timeout=0.0) is not None
    assert result["frames_sent"] == len(heard)
    assert not result["is_complete"]
    assert 179 not in {message.arbitration_id for message in heard}  # TCU_Shift
    truth = ecu_emulator.read_truth(tmp_path / "truth.jsonl")
    assert truth == car.truth
    assert truth.totals is not None
    assert [one.kind for one in truth.totals.faults] == ["silence", "loss"]
    assert process_state() == before
    assert capsys.readouterr() == ("", "")
    with pytest.raises(ecu_emulator.EmulatorConfigError, match="drives only once"), car:
        pass


def test_a_store_tells_what_the_programs_tell(drive_log: Path, tmp_path: Path) -> None:
    store, page = tmp_path / "car.sqlite", tmp_path / "report.html"
    results = diag_service.analyze(drive_log, store=store).results
    told = diag_service.history(store)
    assert told == ended("history", store, "--json").records
    assert diag_service.stored_shift(store, 1) == results[0]
    assert diag_service.write_report(store, page) == page.stat().st_size
    short = page.read_text(encoding="utf-8")
    assert short.startswith("<!DOCTYPE html>")
    assert diag_service.write_report(store, page, is_full=True) == page.stat().st_size
    assert ("<table" in short, "<table" in page.read_text(encoding="utf-8")) == (False, True)
    fill = diag_service.note_fluid(store, at=datetime(2026, 1, 2, tzinfo=UTC), odometer_km=12_345.5, product="fresh")
    assert (fill.filled_at, fill.odometer_m, fill.product) == ("2026-01-02T00:00:00.000000Z", 12_345_500.0, "fresh")
    with pytest.raises(diag_service.ConfigError, match="still to come"):
        diag_service.note_fluid(store, at=datetime(2999, 1, 1, tzinfo=UTC))
    with pytest.raises(diag_service.ConfigError, match=r"written as \.html"):
        diag_service.write_report(store, tmp_path / "report.txt")
    with pytest.raises(diag_service.StoreError):
        diag_service.history(drive_log)
