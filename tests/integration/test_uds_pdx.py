"""A tool that knows a controller by its PDX alone: what it asks is answered, what is answered it understands."""

import json
import re
from ast import literal_eval
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from random import Random
from typing import Any, TypeAlias

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ecu_emulator.cli import main
from ecu_emulator.diagnostics.descriptions import (
    Access,
    Coding,
    Datum,
    ExtendedRecord,
    Field,
    Profile,
    Routine,
    Trouble,
    size_of,
)
from ecu_emulator.diagnostics.pdx.package import pdx_package
from ecu_emulator.diagnostics.table import DiagnosticTable
from ecu_emulator.diagnostics.table_file import shipped_table
from tests.support.documents import page_text
from tests.support.uds.full_table import full_table
from tests.support.uds.pair import MORE, PARKED
from tests.support.uds.pdx_client import PdxClient, read_back, templates_compiled_once

Draw: TypeAlias = Callable[..., Any]  # of hypothesis
OPEN = Access(sessions=(0x01, 0x03, 0x40))
LOCKED = Access(sessions=(0x03, 0x40), levels=(0x01, 0x03), conditions=("standstill",))
SOURCES = st.sampled_from([*PARKED, *MORE, "nothing"])
NAMES = st.one_of(st.sampled_from(["speed", "Speed", "count", "über", "trouble code", "data"]), st.text(max_size=12))
NUMBERS = st.integers(0x0100, 0x0104)


@pytest.fixture(scope="module", autouse=True)
def _compiled_once() -> Iterator[None]:
    with templates_compiled_once():
        yield


@st.composite
def described_fields(draw: Draw, sources: st.SearchStrategy[str], most: int = 3) -> tuple[Field, ...]:
    return tuple(draw(st.lists(st.one_of(numbers(sources), texts(sources)), min_size=1, max_size=most)))


def numbers(sources: st.SearchStrategy[str]) -> st.SearchStrategy[Field]:
    return sources.flatmap(
        lambda source: st.builds(
            Field,
            name=NAMES,
            kind=st.sampled_from([Coding.UNSIGNED, Coding.SIGNED]),
            size_bytes=st.integers(1, 8),
            source=st.just(source),
            unit=st.sampled_from(units_of(source)),
            resolution=st.sampled_from([1.0, 0.25, 0.1, 1e-5, 3.0]),
            offset=st.sampled_from([0.0, -40.0, 0.5]),
        )
    )


def units_of(source: str) -> list[str]:
    """Return units that a source may be told in; any, if its name tells none."""
    dimension = Field(name="", kind=Coding.UNSIGNED, size_bytes=1, source=source).dimension
    own = {"": ["rpm", "%", "m/s²", "km/h"], "rad_s": ["rpm"], "m_s": ["km/h"], "ratio": ["%"]}
    return ["", *own.get(dimension, [])]


def texts(sources: st.SearchStrategy[str]) -> st.SearchStrategy[Field]:
    kinds = st.sampled_from([Coding.TEXT, Coding.BYTES])
    return st.builds(Field, name=NAMES, kind=kinds, size_bytes=st.integers(1, 20), source=sources)


def live_data() -> st.SearchStrategy[Datum]:
    return st.builds(
        Datum,
        number=NUMBERS,
        name=NAMES,
        fields=described_fields(SOURCES),
        read=st.sampled_from([OPEN, LOCKED]),
        control=st.none(),
    )


def stored_data() -> st.SearchStrategy[Datum]:
    return described_fields(st.just("")).flatmap(
        lambda entries: st.builds(
            Datum,
            number=st.integers(0x0200, 0x0202),
            name=NAMES,
            fields=st.just(entries),
            read=st.just(OPEN),
            write=st.sampled_from([OPEN, LOCKED]),
            initial=st.just(("A" if entries[0].kind is Coding.TEXT else "41") * size_of(entries)),
        )
    )


def troubles() -> st.SearchStrategy[Trouble]:
    return st.builds(
        Trouble,
        code=st.sampled_from(["P0811", "U3FFF", "B1234", "C0035"]),
        failure_type=st.integers(0, 255),
        text=NAMES,
        severity=st.sampled_from([0x20, 0x40, 0x80]),
        lights_lamp=st.booleans(),
        failed_step=st.integers(1, 127),
    )


@st.composite
def tables(draw: Draw) -> DiagnosticTable:
    base = shipped_table()
    data: dict[int, Datum] = {
        entry.number: entry for entry in draw(st.lists(st.one_of(live_data(), stored_data()), max_size=4))
    }
    codes: dict[int, Trouble] = {entry.number: entry for entry in draw(st.lists(troubles(), max_size=3))}
    record = ExtendedRecord(number=0x90, name="°", fields=draw(described_fields(st.just("odometer_m"))))
    routine = Routine(number=1, name="r", access=OPEN, duration_s=0.0, results=draw(described_fields(SOURCES)))
    return replace(
        base,
        name=draw(NAMES),
        obd=None,
        services={number: base.services[number] for number in (0x14, 0x19, 0x22, 0x2E, 0x31)},
        data=data,
        routines={routine.number: routine},
        troubles=codes,
        extended={record.number: record} if draw(st.booleans()) else {},
        snapshot=tuple(data),
    )


def test_everything_that_the_package_describes_is_answered_and_understood() -> None:
    figures = PdxClient(full_table(), Random(1)).ask_everything()  # noqa: S311 - to be repeated
    assert figures.problems == []
    assert [name for name in figures.requests if not figures.positive[name]] == []
    assert figures.negative.total() > 100


def test_a_controller_that_speaks_obd_by_uds_offers_its_reports() -> None:
    table = shipped_table()
    assert table.obd is not None
    services = {number: table.services[number] for number in (0x14, 0x19, 0x22)}
    table = replace(
        table,
        obd=replace(table.obd, profile=Profile.UDS),
        services=services,
        data={0xF190: table.data[0xF190]},
        snapshot=(),
    )
    figures = PdxClient(table, Random(1)).ask_everything(most_situations=4)  # noqa: S311 - to be repeated
    assert figures.problems == []
    obd = {"Read_trouble_codes_of_OBD", "Read_permanent_trouble_codes", "Clear_trouble_codes_of_OBD"}
    obd |= {"Read_OBD_engine_speed", "Read_OBD_vehicle_identification_number", "Read_OBD_supported_F400"}
    assert all(figures.positive[name] for name in obd)


def test_obd_is_a_layer_of_its_own_of_which_everything_is_answered_and_understood() -> None:
    client = PdxClient(shipped_table(), Random(1), container=1)  # noqa: S311 - to be repeated
    figures = client.ask_everything(most_situations=6)
    assert figures.problems == []
    assert [name for name in figures.requests if not figures.positive[name]] == []
    assert {name.partition("_")[0] for name in figures.requests} == {"Read", "Clear"}
    speed = client.layer.services.Read_engine_speed
    assert bytes(speed.encode_request()) == b"\x01\x0c"
    assert speed.decode_message(b"\x41\x0c\x10\x00").param_dict["engine_speed"] == {"speed": 1024.0}
    codes: Any = client.layer.services.Read_confirmed_trouble_codes.decode_message(b"\x43\x01\x08\x11").param_dict
    assert [code["trouble_code"].display_trouble_code for code in codes["trouble_codes"]] == ["P0811"]


@settings(max_examples=10)
@given(table=tables(), seed=st.integers(0, 99))
def test_so_it_is_with_tables_of_ones_own(table: DiagnosticTable, seed: int) -> None:
    client = PdxClient(table, Random(seed))  # noqa: S311 - to be repeated
    assert client.ask_everything(most_situations=3).problems == []
    assert client.package == pdx_package(replace(table))


def test_the_command_writes_the_package(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "own.pdx"
    assert main(["pdx", "-o", str(path), "--json"]) == 0
    said = capsys.readouterr()
    assert json.loads(said.out) == {"file": str(path), "controller": "TCU", "bytes": path.stat().st_size}
    assert "25 trouble codes" in said.err.replace("\n", " ")
    assert path.read_bytes() == pdx_package(shipped_table())
    assert read_back(path.read_bytes()).short_name == "TCU"


def test_the_page_reads_the_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (block,) = re.findall(
        r"^```python\n(import odxtools .*?)^```", page_text("docs/diagnostics.md"), re.MULTILINE | re.DOTALL
    )
    *body, last = block.splitlines()
    monkeypatch.chdir(tmp_path)
    assert main(["pdx"]) == 0
    names: dict[str, Any] = {}
    exec("\n".join(body), names)  # noqa: S102 - what the page is for
    code, _, shown = last.partition("  # ")
    assert eval(code, names) == literal_eval(shown)  # noqa: S307 - likewise


@pytest.mark.parametrize(
    ("table", "output", "status", "complaint"),
    [
        ("missing.toml", "x.pdx", 2, "cannot read missing.toml: No such file or directory"),
        ("bad.toml", "x.pdx", 2, "bad.toml is not TOML"),
        ("bad.toml", "bad.toml", 2, "table and package cannot both be bad.toml"),
        (None, "missing/x.pdx", 4, "cannot write missing/x.pdx: No such file or directory"),
    ],
)
def test_what_cannot_be_read_or_written_is_told_in_a_line(
    table: str | None,
    output: str,
    status: int,
    complaint: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("bad.toml").write_text("name = ")
    assert main(["pdx", *([table] if table else []), "-o", output]) == status
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"ecu-emulator: error: {complaint}")
    assert not Path("x.pdx").exists()
    assert Path("bad.toml").read_text() == "name = "
