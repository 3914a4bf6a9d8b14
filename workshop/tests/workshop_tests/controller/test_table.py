"""The table of data, and its document."""

from pathlib import Path

import pytest

from ecu_emulator.errors import EmulatorConfigError
from tests.support.documents import page_text
from tests.tools.uds_tables import page
from workshop.controller.memory import TestResult
from workshop.controller.table import parse_table, shipped_table, table_like
from workshop_tests.controller.bench import Bench

TEXT = (Path(__file__).parents[4] / "workshop/src/workshop/controller/tcu.toml").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("p2_s = 0.05", "p2_s = 0.0", "timing.p2_s must be above 0"),
        ("p2_s = 0.05", "p2_s = 70.0", "timing.p2_s must be above 0 and at most 65 s"),
        ('unit = "km/h"', 'unit = "mph"', "the unit of vehicle_speed_m_s is one of m/s, km/h, not mph"),
        ("request_id = 0x7E1", "request_id = -1", "request_id must not be negative"),
        ('code = "P0811"\n', 'code = "X0811"\n', "trouble code X0811 is none"),
        ('code = "P0811"\n', 'code = "P4811"\n', "trouble code P4811 is none"),
        ('code = "P0841"\n', 'code = "P0711"\n', "trouble 0x71164 is there twice"),
        ("failed_step = 64", "failed_step = 128", "P0780: failed_step must be 1..127, got 128"),
        (
            'task = "new_fluid"\nduration_s = 60.0\nends_by_itself = false', 'task = "new_fluid"\nduration_s = 60.0',
            "routine clear adaptation after fluid change: the vehicle ends task new_fluid, not the time",
        ),
        (
            'task = "touch_points"', 'task = "nothing"',
            "routine adaptation of the clutches: held_conditions belong to task touch_points",
        ),
        ('held_conditions = ["standstill"', 'held_conditions = ["flying"', "condition flying is not described"),
        ("most_temperature_k = 423.15", "most_temperature_k = 150.0", "most_temperature_k must be 273.15..1273.15 K"),
        ("most_touch_change_pa = 25000.0", "most_touch_change_pa = 0.0", "most_touch_change_pa must be above 0"),
        ("number = 0x0310", "number = 0x0302", "data 0x302 is there twice"),
        ('kind = "signed"', 'kind = "float"', "a float has 4 or 8 bytes and is not scaled"),
        ("ends_by_itself = false", "ends_by_itself = true", "task revs has two options of one byte"),
        ("size_bytes = 17", "size_bytes = 18", "initial must have 18 bytes"),
        ('initial = "EA60"', 'initial = "EA6"', "initial is neither ASCII text nor hexadecimal"),
        ('pattern = "[0-9A-Z]{10}"', 'pattern = "["', "pattern is not a regular expression"),
        ('read = "open"\ninitial = "0100"', 'read = "open"', "either every field has a source, or there is an initial"),
        ("maximum = 0.5, nrc = 0x88", "maximum = 0.5, nrc = 0x99", "nrc 0x99 is unknown"),
        ('conditions = ["standstill"]', 'conditions = ["flying"]', "condition flying is not"),
        ("snapshot = [0x0100", "snapshot = [0x0999", "data 0x999 is not described"),
        ("sessions = [0x40]", "sessions = [0x41]", "session 0x41 is not described"),
        ('number = 0x03\nname = "maker"', 'number = 0x04\nname = "maker"', "its number must be odd"),
        ("key_mask = 0x5AA5C33C", "key_mask = 0", "key_mask must fit 4 bytes and not be 0"),
        ("resolution = 0.25", "resolution = 0.0", "resolution must be > 0"),
        ("minimum = 10000.0", "minimum = 60001.0", "minimum and maximum [60001.0, 60000.0] are not a range"),
        ("minimum = 30.0", "minimum = nan", "engine_running: minimum and maximum [nan] are not a range"),
        ('code = "P0811"\n', 'code = "P0811-07"\n', "P0811-07 is none: in capitals, as P0741, its failure_type apart"),
        ("[limits]", "[limits", "is not TOML"),
        ("response_id = 0x7E9", "response_id = 0x7E1", "three identifiers, of 29 bits at most, must differ"),
        ("most_response_bytes = 4095", "most_response_bytes = 4096", "most_response_bytes must be 8..4095"),
        ("most_data = 16", "most_data = 0", "most_data must be at least 1"),
        ("number = 0x0206", "number = 0x10206", "data 0x10206 is above 0xFFFF"),
        ("number = 0x85", "number = 0x185", "service 0x185 is above 0xFF"),
        ('source = "odometer_m", unit = "km", resolution = 0.001 },\n  {', 'source = "memory.x" },\n  {', "either all"),
    ],
)  # fmt: skip
def test_what_is_wrong_is_named(old: str, new: str, message: str) -> None:
    assert old in TEXT
    with pytest.raises(EmulatorConfigError) as told:
        parse_table(TEXT.replace(old, new, 1), "my.toml")
    assert str(told.value).startswith("my.toml")
    assert message in str(told.value)
    assert "\n" not in str(told.value)


def test_the_page_lists_each_service_datum_routine_and_code() -> None:
    table = shipped_table()
    rows = [line for line in page(table).splitlines() if line.startswith("| ") and "---" not in line]
    assert table.obd is not None
    kinds = (table.services, table.data, table.conditions, table.troubles, table.routines)
    of_obd = (table.obd.pids, table.obd.monitors, table.obd.infos)
    fault_sets = {str(trouble.faults) for trouble in table.troubles.values() if trouble.faults}
    assert len(rows) == sum(len(kind) + 1 for kind in (*kinds, *of_obd, fault_sets))  # a head each


def test_the_dialogue_of_the_document_is_what_the_controller_answers() -> None:
    _, _, dialogue = page_text("docs/controller.md").partition("<!-- dialogue -->")
    bench, said = Bench(table=shipped_table()), ""
    bench.monitor("P0811", TestResult.FAILED)
    lines = [line for line in dialogue.splitlines() if line.startswith("7E")]
    assert len(lines) > 10
    for line in lines:
        told = line[5:69].strip().lower()
        if line.startswith("7E1"):
            said = bench.ask(told)
            continue
        begins, _, size = told.partition(" ... ")
        assert said.startswith(begins)
        assert len(bytes.fromhex(said)) == (int(size.removesuffix(" bytes")) if size else len(bytes.fromhex(begins)))
        if said == "7f 31 78":
            bench.finish(0x0301)
            said = bench.wait(0.1)


def test_a_personality_is_of_its_own_kind_of_transmission() -> None:
    table = table_like("gm_t87a", "lockup")
    assert (table.addressing.request_id, table.addressing.response_id) == (0x7E2, 0x7EA)
    assert {0x1941, 0x1942, 0x194F, 0x281C, 0x19D4, 0x199A} <= table.data.keys()
    with pytest.raises(EmulatorConfigError, match="gm_t87a answers for an automatic with a converter"):
        table_like("gm_t87a")
    with pytest.raises(EmulatorConfigError, match="vw_dsg answers for a dual clutch"):
        table_like("vw_dsg", "lockup")
