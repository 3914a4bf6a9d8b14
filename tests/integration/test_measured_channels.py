"""Measured channels of MDF 4 files: names, units, conversions, rates, invalid values; cut off or beside frames."""

from pathlib import Path

import numpy as np
import pytest
from asammdf import MDF, Signal

from canlog.database.signal_columns import column_id
from canlog.errors import SourceError
from canlog.frames import EXTENDED_FLAG
from canlog.logs import LogFormat, LogReader, read_log
from canlog.logs.mf4 import one_each
from ecu_emulator.log_formats import open_log
from tests.support.measurements import START, Measured, written
from tests.support.mf4_layouts import Layout, laid_out
from tests.support.traffic import START_NS, random_frames

FAST_S, SLOW_S = np.arange(0.0, 20.0, 0.01), np.arange(0.003, 20.0, 0.1)
SPEED = np.round(1000.0 + 500.0 * np.sin(FAST_S), 2)
PRESSURE = np.round(2.0 + np.cos(FAST_S), 3)
TEMPERATURE = np.round(80.0 + SLOW_S, 1)
FAST = [
    Measured("nEng\\ETKC:1", "rpm", SPEED, 0.25),
    Measured("pCl1\\ETKC:1", "bar", PRESSURE, 0.001, -1.0, dtype="<u2"),
]
SLOW = [Measured("TOil", "degC", TEMPERATURE, 0.1, -40.0, SLOW_S > 15.0), Measured("nEng\\ETKC:1", "rpm", SLOW_S)]
GROUPS = [(FAST_S, FAST), (SLOW_S, SLOW)]
COLUMNS = [("nEng\\ETKC:1", "rpm"), ("pCl1\\ETKC:1", "bar"), ("TOil", "degC"), ("nEng\\ETKC:1 (2)", "rpm")]


def values(path: Path) -> tuple[LogReader, dict[str, tuple[list[float], list[int]]]]:
    """Return what a file holds by the names of its channels: values, and times [us] from its start."""
    with read_log(path) as reader:
        batches, found = list(reader), {}
    start_us = round(START.timestamp() * 1e6)
    for column in reader.columns:
        rows = [one[one.can_id == (column_id(column.name) | EXTENDED_FLAG)] for one in batches]
        data = np.concatenate([np.ascontiguousarray(one.data[:, :8]) for one in rows])
        times = np.concatenate([one.t_ns for one in rows]) // 1000 - start_us
        found[column.name] = (data.view("<f8").ravel().tolist(), times.tolist())
    assert all(np.diff(np.concatenate([one.t_ns for one in batches])) >= 0)
    return reader, found


def test_arrays_of_one_are_numbers_and_longer_ones_are_refused_by_name() -> None:
    assert one_each(np.array([[3], [5]]), "biuf", "BusChannel").tolist() == [3, 5]
    with pytest.raises(SourceError, match="BusChannel: not one number for each record"):
        one_each(np.zeros((2, 3)), "biuf", "BusChannel")


@pytest.mark.parametrize("version", ["4.00", "4.10", "4.20"])
def test_groups_of_different_rates_are_columns_with_times_of_their_own(tmp_path: Path, version: str) -> None:
    path = tmp_path / "bench.mf4"
    written(path, GROUPS, version=version)
    reader, found = values(path)
    assert reader.format is LogFormat.MF4
    assert [(one.name, one.unit) for one in reader.columns] == COLUMNS
    assert found["nEng\\ETKC:1"][0] == pytest.approx(np.rint(SPEED / 0.25) * 0.25, abs=1e-9)
    assert found["pCl1\\ETKC:1"][0] == pytest.approx(PRESSURE, abs=1e-9)
    assert found["nEng\\ETKC:1"][1] == np.rint(FAST_S * 1e6).tolist()
    is_valid = SLOW_S <= 15.0  # the others are marked as invalid
    assert found["TOil"][0] == pytest.approx(TEMPERATURE[is_valid], abs=1e-9)
    assert found["TOil"][1] == np.rint(SLOW_S[is_valid] * 1e6).tolist()
    assert found["nEng\\ETKC:1 (2)"][0] == SLOW_S.tolist()
    counts = reader.counts
    assert counts.frames == 2 * len(FAST_S) + len(SLOW_S) + int(is_valid.sum())
    assert any("are called 'nEng\\\\ETKC:1': the others are numbered" in note for note in counts.notes)
    assert not counts.rejected


@pytest.mark.parametrize("codes", [{"val_0": 255}, {"lower_0": 254, "upper_0": 255}])
def test_codes_beside_a_scale_are_no_values_and_the_others_are_scaled(tmp_path: Path, codes: dict[str, int]) -> None:
    path, raw = tmp_path / "codes.mf4", np.where(np.arange(200) % 7, np.arange(200), 255).astype("u1")
    conversion = {**codes, "text_0": "SNA", "default_addr": {"a": 0.5, "b": -40.0}}
    with MDF(version="4.10") as file:
        file.append([
            Signal(raw, np.arange(200) / 100.0, name="TOil", unit="degC", conversion=conversion),
            Signal(np.full(200, 255, "u1"), np.arange(200) / 100.0, name="TNone", unit="degC", conversion=conversion),
            Signal(raw, np.arange(200) / 100.0, name="Raw"),
        ])  # fmt: skip
        file.save(path)
    _, found = values(path)
    assert found["TOil"][0] == (0.5 * raw[raw != 255] - 40.0).tolist()
    assert found["TNone"][0] == []
    assert found["Raw"][0] == raw.tolist()


def test_frames_beside_channels_are_the_log_and_the_channels_are_told(tmp_path: Path) -> None:
    frames, path = tmp_path / "frames.mf4", tmp_path / "both.mf4"
    with open_log(frames, start_ns=START_NS) as log:
        log.write(random_frames(40))
    with MDF(frames) as file:
        file.append([Signal(np.arange(50.0), np.arange(50.0), name="Load", unit="%")])
        file.save(path)
    with read_log(path) as reader:
        assert reader.columns == ()
        assert sum(map(len, reader)) > 0
    assert any("1 measured channels beside the frames of buses are left out" in note for note in reader.counts.notes)


@pytest.mark.parametrize("is_sorted", [True, False])
def test_a_file_that_was_not_closed_tells_every_row_that_is_there(tmp_path: Path, is_sorted: bool) -> None:
    whole, path = tmp_path / "whole.mf4", tmp_path / "cut.mf4"
    written(whole, GROUPS[:1], compression=0)
    recording = laid_out(whole, Layout.PLAIN, is_sorted=is_sorted, is_finished=False)
    path.write_bytes(recording.contents[: int(recording.record_ends[1000]) + 5])
    before = path.read_bytes()
    reader, found = values(path)
    assert reader.counts.unfinished
    assert found["nEng\\ETKC:1"][0] == pytest.approx(np.rint(SPEED / 0.25)[:1001] * 0.25, abs=1e-9)
    assert path.read_bytes() == before  # asammdf completes a copy
