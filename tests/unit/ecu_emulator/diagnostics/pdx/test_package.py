"""A PDX says what the table says: names, scaling, limits, sessions, how the controller is reached."""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any, TypeAlias

import pytest

from ecu_emulator.diagnostics.descriptions import Access, Coding, Datum, Field
from ecu_emulator.diagnostics.pdx.package import pdx_package
from ecu_emulator.diagnostics.table_file import shipped_table
from tests.support.uds.full_table import full_table
from tests.support.uds.pdx_client import read_back, templates_compiled_once

Layer: TypeAlias = Any  # of odxtools, which finds names at run time


@pytest.fixture(scope="module", autouse=True)
def _compiled_once() -> Iterator[None]:
    with templates_compiled_once():
        yield


@pytest.fixture(scope="module")
def layer() -> Layer:
    return read_back(pdx_package(full_table()))


def with_fields(*fields: Field, initial: str | None = None) -> Layer:
    """Return what odxtools reads of a table with one datum more."""
    table = shipped_table()
    datum = Datum(number=0x0999, name="new one", fields=fields, read=Access(sessions=(1,)), initial=initial)
    return read_back(pdx_package(replace(table, data={**table.data, datum.number: datum}))).services["Read_new_one"]


def test_sessions_and_security_are_states(layer: Layer) -> None:
    charts = {chart.short_name: chart for chart in layer.state_charts}
    assert [state.short_name for state in charts["Session"].states] == [
        "session_default", "session_extended", "session_end_of_line",
    ]  # fmt: skip
    assert charts["Security"].start_state.short_name == "locked"
    written = layer.services.Write_vehicle_identification_number
    assert {entry.state.short_name for entry in written.pre_condition_state_refs} == {
        "session_end_of_line", "unlocked_maker",
    }  # fmt: skip
    entered = layer.services.Start_session_end_of_line
    changes = {entry.state_transition.short_name for entry in entered.state_transition_refs}
    assert "session_extended_to_session_end_of_line" in changes
    assert "session_default_to_session_end_of_line" not in changes
    assert "unlocked_workshop_to_locked" in changes
    assert not layer.services.Read_vehicle_speed.pre_condition_state_refs


def test_names_that_are_none_for_odx_or_come_twice_are_told_apart() -> None:
    fields = (
        Field(name="Kühlung [%]", kind=Coding.UNSIGNED, size_bytes=1, source="a"),
        Field(name="Kühlung <%>", kind=Coding.UNSIGNED, size_bytes=1, source="b"),
        Field(name="…", kind=Coding.UNSIGNED, size_bytes=1, source="c"),
    )
    service = with_fields(*fields)
    found = service.decode_message(bytes.fromhex("62 09 99 01 02 03")).param_dict["new_one"]
    assert found == {"K_hlung": 1, "K_hlung_2": 2, "unnamed": 3}
    parameters = service.positive_responses[0].parameters.new_one.dop.parameters
    assert [entry.long_name for entry in parameters] == ["Kühlung [%]", "Kühlung <%>", "…"]


def test_meanings_stand_for_numbers() -> None:
    gear = Field(name="lever", kind=Coding.UNSIGNED, size_bytes=1, source="a", meanings={"0": "P", "0x10": "D"})
    service = with_fields(gear)
    texts = [
        service.decode_message(bytes.fromhex(f"62 09 99 {raw}")).param_dict["new_one"]["lever"]
        for raw in ("00", "10", "07")
    ]
    assert texts == ["P", "D", "undefined"]
