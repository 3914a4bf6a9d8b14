"""Channels of MDF 4 files in other shapes and types than bus logging has: read where that is safe, else named."""

from collections.abc import Mapping
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
import pytest
from asammdf import MDF, Signal
from asammdf.blocks.v4_blocks import SourceInformation
from asammdf.blocks.v4_constants import BUS_TYPE_CAN, SOURCE_BUS

from canlog.errors import SourceError
from canlog.frames import FrameBatch, join
from canlog.logs import read_log
from diag_service.cli import main

FIELDS: Mapping[str, tuple[str, tuple[int, ...]]] = {
    "BusChannel": ("u1", ()),
    "ID": ("<u4", ()),
    "IDE": ("u1", ()),
    "DLC": ("u1", ()),
    "DataLength": ("u1", ()),
    "DataBytes": ("u1", (8,)),
    "Dir": ("u1", ()),
}
BUS = SourceInformation(source_type=SOURCE_BUS, bus_type=BUS_TYPE_CAN)
COUNT = 50


def written(path: Path, fields: Mapping[str, tuple[str, tuple[int, ...]]]) -> None:
    """Write frames of 8 bytes on channel 3 with identifiers from 100 on, every other one sent."""
    samples = np.zeros(COUNT, [(f"CAN_DataFrame.{name}", kind, shape) for name, (kind, shape) in fields.items()])
    for name, (_, shape) in fields.items():
        values = {"BusChannel": 3, "DLC": 8, "DataLength": 8, "DataBytes": 7, "IDE": 0}.get(name, np.arange(COUNT))
        values = 0x100 + np.arange(COUNT) if name == "ID" else np.arange(COUNT) % 2 if name == "Dir" else values
        samples[f"CAN_DataFrame.{name}"] = np.reshape(values, (-1, 1)) if shape else values
    with MDF(version="4.10") as file:
        file.header.start_time = datetime(2026, 1, 31, tzinfo=UTC)
        file.append(Signal(name="CAN_DataFrame", samples=samples, timestamps=np.arange(COUNT) / 100.0, source=BUS))
        file.save(path)


def frames(path: Path) -> FrameBatch:
    with read_log(path) as reader:
        return join(list(reader))


@pytest.mark.parametrize("shaped", [("BusChannel", "IDE", "DLC", "Dir"), tuple(set(FIELDS) - {"DataBytes"})])
def test_arrays_of_one_are_read_as_what_they_hold(tmp_path: Path, shaped: tuple[str, ...]) -> None:
    written(tmp_path / "plain.mf4", FIELDS)
    written(tmp_path / "arrays.mf4", {**FIELDS, **{name: (FIELDS[name][0], (1,)) for name in shaped}})
    expected, found = frames(tmp_path / "plain.mf4"), frames(tmp_path / "arrays.mf4")
    assert len(expected) == COUNT
    for name in ("t_ns", "can_id", "length", "data", "flags", "channel"):
        assert getattr(found, name).tolist() == getattr(expected, name).tolist()


@pytest.mark.parametrize(
    ("field", "kind", "shape", "said"),
    [
        ("BusChannel", "u1", (2,), r"CAN_DataFrame\.BusChannel: not one number for each record, but uint8 of shape"),
        ("ID", "u1", (4,), r"CAN_DataFrame\.ID: not one number for each record"),
        ("ID", "S8", (), r"CAN_DataFrame\.ID: not one number for each record, but \|S8 of shape"),
        ("DataBytes", "<u8", (), r"CAN_DataFrame\.DataBytes: not bytes, but uint64"),
    ],
)
def test_what_cannot_be_a_field_of_frames_is_named_with_its_group(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    field: str,
    kind: str,
    shape: tuple[int, ...],
    said: str,
) -> None:
    path = tmp_path / "odd.mf4"
    written(path, {**FIELDS, field: (kind, shape)})
    with pytest.raises(SourceError, match=r"group 0, CAN_DataFrame: " + said):
        frames(path)
    assert main(["inspect", str(path)]) == 3
    assert "unexpected" not in capsys.readouterr().err


def test_frames_without_identifiers_are_none(tmp_path: Path) -> None:
    written(tmp_path / "odd.mf4", {name: one for name, one in FIELDS.items() if name != "ID"})
    with pytest.raises(SourceError, match="group 0, CAN_DataFrame: no channel holds the identifiers"):
        frames(tmp_path / "odd.mf4")
