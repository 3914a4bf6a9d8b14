"""A PDX says what the table says: names, scaling, limits, sessions, how the controller is reached."""

import io
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from typing import Any, TypeAlias
from xml.etree import ElementTree as ET

import pytest

from ecu_emulator.diagnostics.descriptions import Access, Coding, Datum, Field
from ecu_emulator.diagnostics.pdx.package import pdx_package
from ecu_emulator.diagnostics.table import DiagnosticTable
from ecu_emulator.diagnostics.table_file import shipped_table
from ecu_emulator.diagnostics.values import decode_number
from ecu_emulator.errors import ConfigError
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


def files(table: DiagnosticTable) -> dict[str, bytes]:
    with zipfile.ZipFile(io.BytesIO(pdx_package(table))) as archive:
        assert archive.testzip() is None
        return {name: archive.read(name) for name in archive.namelist()}


def with_fields(*fields: Field, initial: str | None = None) -> Layer:
    """Return what odxtools reads of a table with one datum more."""
    table = shipped_table()
    datum = Datum(number=0x0999, name="new one", fields=fields, read=Access(sessions=(1,)), initial=initial)
    return read_back(pdx_package(replace(table, data={**table.data, datum.number: datum}))).services["Read_new_one"]


def test_the_same_table_gives_the_same_bytes() -> None:
    assert pdx_package(shipped_table()) == pdx_package(replace(shipped_table()))
    assert pdx_package(shipped_table()) != pdx_package(full_table())


def test_the_catalogue_names_every_file() -> None:
    content = files(shipped_table())
    catalogue = ET.fromstring(content["index.xml"])  # noqa: S314 - our own
    assert {entry.text for entry in catalogue.iter("FILE")} == set(content) - {"index.xml"}
    assert {name.rpartition(".")[2] for name in content} == {"xml", "odx-d", "odx-c", "odx-cs"}


def test_identifiers_are_unique_and_references_lead_somewhere() -> None:
    for name, text in files(full_table()).items():
        root = ET.fromstring(text)  # noqa: S314 - our own
        identifiers = [element.attrib["ID"] for element in root.iter() if "ID" in element.attrib]
        assert len(set(identifiers)) == len(identifiers), name
        references = {
            element.attrib["ID-REF"]
            for element in root.iter()
            if "DOCREF" not in element.attrib and "ID-REF" in element.attrib
        }
        assert references <= set(identifiers), name


def test_values_are_in_their_unit(layer: Layer) -> None:
    speed = layer.services.Read_vehicle_speed.decode_message(bytes.fromhex("62 01 02 12 34"))
    assert speed.param_dict["vehicle_speed"] == {"speed": pytest.approx(46.60)}
    torque = layer.services.Read_engine_torque.decode_message(bytes.fromhex("62 01 06 ff 85"))
    assert torque.param_dict["engine_torque"] == {"torque": pytest.approx(-12.3)}
    vin = layer.services.Read_vehicle_identification_number.decode_message(b"\x62\xf1\x90" + b"WVWZZZ1KZ5W000001")
    assert list(vin.param_dict["vehicle_identification_number"].values()) == ["WVWZZZ1KZ5W000001"]
    fluid = layer.services.Read_fluid_temperature.positive_responses[0].parameters.fluid_temperature.dop
    assert fluid.parameters.temperature.dop.unit.display_name == "degC"


def test_every_number_of_the_table_is_scaled_as_the_table_says(layer: Layer) -> None:
    for datum in full_table().data.values():
        raw = bytes(0x21 + place for place in range(datum.size_bytes))
        service = next(entry for entry in layer.services if entry.long_name == f"Read {datum.name}")
        response = service.decode_message(b"\x62" + datum.number.to_bytes(2, "big") + raw).param_dict
        values, place = list(list(response.values())[-1].values()), 0
        for entry, value in zip(datum.fields, values, strict=True):
            piece, place = raw[place : place + entry.size_bytes], place + entry.size_bytes
            if entry.kind in {Coding.UNSIGNED, Coding.SIGNED}:
                assert value == pytest.approx(decode_number(entry, piece)), entry.name
            else:
                assert value in {piece, piece.decode("latin-1")}


def test_what_is_not_available_is_marked_so(layer: Layer) -> None:
    dops = layer.diag_data_dictionary_spec.data_object_props
    for name, number in (("vehicle_speed_speed", 0xFFFF), ("engine_torque_torque", -32768)):
        (constraint,) = dops[name].internal_constr.scale_constrs
        assert (constraint.lower_limit.value, constraint.upper_limit.value) == (number, number)
        assert constraint.validity.value == "NOT-AVAILABLE"


def test_what_may_be_written_has_limits(layer: Layer) -> None:
    dop = layer.diag_data_dictionary_spec.data_object_props.interval_of_fluid_changes_distance
    assert (dop.physical_constr.lower_limit.value, dop.physical_constr.upper_limit.value) == (10000, 60000)


def test_every_trouble_code_is_there(layer: Layer) -> None:
    (dop,) = layer.diag_data_dictionary_spec.dtc_dops
    codes = {code.trouble_code: (code.display_trouble_code, code.text.text, code.level) for code in dop.dtcs}
    assert codes == {
        trouble.number: (f"{trouble.code}-{trouble.failure_type:02X}", trouble.text, trouble.severity)
        for trouble in full_table().troubles.values()
    }


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


def test_conditions_of_the_vehicle_are_told_in_words(layer: Layer) -> None:
    assert "standstill (else 88)" in layer.services.Adjust_fluid_temperature.description.text


def test_a_positive_response_can_be_suppressed_where_there_is_a_sub_function(layer: Layer) -> None:
    assert layer.services.Tester_present.pos_response_suppressible.bit_mask == 0x80
    assert layer.services.Read_vehicle_speed.pos_response_suppressible is None


def test_a_tool_finds_the_controller(layer: Layer) -> None:
    assert (layer.get_can_receive_id(), layer.get_can_send_id(), layer.get_can_func_req_id()) == (0x7E1, 0x7E9, 0x7DF)
    assert layer.get_tester_present_time() == pytest.approx(2.0)
    values = {entry.short_name: entry.value for entry in layer.comparam_refs}
    assert (values["CP_P2Max"], values["CP_P2Star"], values["CP_CanFillerByte"]) == ("50000", "5000000", "204")


@pytest.mark.parametrize(("coded", "microseconds"), [(5, "5000"), (0xF9, "900")])
def test_the_separation_time_is_in_microseconds(coded: int, microseconds: str) -> None:
    table = shipped_table()
    other = replace(table, transport=replace(table.transport, separation_time=coded))
    values = {entry.short_name: entry.value for entry in read_back(pdx_package(other)).comparam_refs}  # type: ignore[attr-defined]  # a hierarchy element
    assert values["CP_StMin"] == microseconds


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


@pytest.mark.parametrize("number", ["x", "256", "-1"])
def test_a_meaning_of_no_number_of_the_field_is_refused(number: str) -> None:
    with pytest.raises(ConfigError, match="meanings are of"):
        Field(name="lever", kind=Coding.UNSIGNED, size_bytes=1, source="a", meanings={number: "P"})


def test_a_number_too_long_for_odx_is_bytes_with_an_explanation() -> None:
    service = with_fields(Field(name="energy", kind=Coding.SIGNED, size_bytes=6, source="a", unit="J", resolution=0.5))
    assert service.decode_message(bytes.fromhex("62 09 99 01 02 03 04 05 06")).param_dict["new_one"] == {
        "energy": bytes(range(1, 7))
    }
    dop = service.positive_responses[0].parameters.new_one.dop.parameters.energy.dop
    assert "0.5 J a step" in dop.description.text


def test_characters_that_xml_does_not_have_are_replaced() -> None:
    with_fields(Field(name="a\x01b", kind=Coding.UNSIGNED, size_bytes=1, source="a", unit="\x02\ud800"))
