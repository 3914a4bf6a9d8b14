"""Tables of signals wherever logs are taken: the same results as from frames, and a profile proposed for them."""

import gzip
import json
import lzma
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import diag_service
from canlog.logs import read_log
from clutch_results.records import shift_record
from dbc.contract import load_contract
from diag_service.console import reading_text
from diag_service.mapping.profile import PROFILE_PATH
from ecu_emulator.cli import main as emulator
from studies.builders import OF_FRICTION, OUTPUT, with_fuel, written
from tests.support.documents import ROOT
from tests.support.in_process import ended

OTHER = {"stream", "trust"}  # a table has no counters and checksums that could be trusted
GOLDEN = ROOT / "tests" / "golden" / "recordings"


@pytest.fixture(name="log", scope="module")
def _log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("tables") / "case1.log"
    path.write_bytes(lzma.decompress((GOLDEN / "case1.log.xz").read_bytes()))
    return path


@pytest.fixture(name="profile", scope="module")
def _profile(log: Path) -> Path:
    # The shipped profile, with the columns that ``decode`` writes in place of messages and signals.
    database, lines = load_contract(), ['name = "columns"', "[signals]"]
    for signal, source in tomllib.loads(PROFILE_PATH.read_text(encoding="utf-8"))["signals"].items():
        unit = database.get_message_by_name(source["message"]).get_signal_by_name(source["signal"]).unit or ""
        column = f"{source.pop('message')}.{source.pop('signal')}"
        words = {"column": column, "unit": unit, **source}
        lines.append(f"{signal} = {{ {', '.join(f'{key} = {json.dumps(value)}' for key, value in words.items())} }}")
    path = log.with_name("columns.toml")
    path.write_text("\n".join(lines), encoding="utf-8")
    return path


def analysed(log: Path, *words: str | Path) -> list[dict[str, Any]]:
    output = log.with_name("results.jsonl")
    run = ended("analyze", log, *words, "-o", output, "--force")
    assert run.status == 0, run.err
    records = [json.loads(line) for line in output.read_text(encoding="utf-8").splitlines()]
    return [record for record in records if "from_gear" in record]


def near(value: object) -> object:
    """Return what of a record can be the same, that equals another one to 1e-6."""
    if isinstance(value, dict):
        return {key: near(one) for key, one in value.items() if key not in OTHER}
    return pytest.approx(value, rel=1e-6, abs=1e-12) if isinstance(value, float) else value


def test_a_table_gives_what_its_frames_give(log: Path, profile: Path) -> None:
    table = log.with_suffix(".csv")
    run = ended("decode", log, "-o", table, "--layout", "wide", "--force")
    assert run.status == 0, run.err
    from_frames, from_table = analysed(log), analysed(table, "--profile", profile)
    assert len(from_table) == len(from_frames) == 10
    for frames, cells in zip(from_frames, from_table, strict=True):
        assert {key: one for key, one in cells.items() if key not in OTHER} == near(frames)


def road(path: Path) -> tuple[float, ...]:
    """Write a table of a car that accelerates through its gears, as a scan tool does, and return their ratios."""
    ratios, rng = (3.9, 2.3, 1.5, 1.1), np.random.default_rng(7)
    t_ms, output = np.arange(0, 60_000, 40), np.linspace(300.0, 3000.0, 1500)
    gear = np.clip((t_ms // 15_000) + 1, 1, 4)
    settled = np.minimum((t_ms % 15_000) / 800.0, 1.0)  # the engine follows within .8 s of slip
    before = np.array(ratios)[np.maximum(gear - 2, 0)]
    engine = output * (before + (np.array(ratios)[gear - 1] - before) * settled)
    rows = zip(t_ms, engine + rng.normal(0.0, 2.0, 1500), output, gear, 200.0 + 50.0 * settled, strict=True)
    head = "Time [ms],Engine Speed,Output Shaft Speed,Commanded Gear,Clutch 1 Pressure,Note"
    path.write_text("\n".join([head, *(f"{t},{e:.1f},{o:.2f},{g},{p:.2f},ok" for t, e, o, g, p in rows), ""]))
    return ratios


def test_a_profile_is_proposed_with_the_ratios_that_the_table_shows(tmp_path: Path) -> None:
    table, profile = tmp_path / "drive.csv", tmp_path / "drive.toml"
    ratios = road(table)
    run = ended("signals", table)
    assert run.status == 0, run.err
    profile.write_text(run.out, encoding="utf-8")
    proposed = tomllib.loads(run.out)
    assert proposed["signals"]["engine_speed_rad_s"] == {"column": "Engine Speed", "unit": "rpm"}
    assert proposed["signals"]["clutch1_pressure_pa"] == {"column": "Clutch 1 Pressure", "unit": "kPa"}
    assert "assumed: nothing says the unit" in run.out
    assert proposed["gears"]["ratios"] == pytest.approx(ratios, rel=0.005)
    assert "columns of words are left out: Note" in ended("inspect", table).out
    found = analysed(table, "--profile", profile)
    assert [(one["from_gear"], one["to_gear"], one["clutch"]) for one in found] == [(1, 2, 2), (2, 3, 1), (3, 4, 2)]
    assert {one["status"] for one in found} == {"unobserved"}


def automatic(path: Path) -> None:
    """Write a table of an automatic as scripts make of a tuner's log: sparse rows, and names of misleading units."""
    rng, count = np.random.default_rng(11), 6000
    gear = np.repeat([3.0, 4.0, 5.0], count // 3)
    turbine = np.round(8.0 * (1500.0 + 300.0 * np.sin(np.arange(count) / 400.0))) / 8.0
    slip = np.round(8.0 * np.abs(15.0 + rng.normal(0.0, 6.0, count))) / 8.0
    torque_nm = np.round(2.0 * (150.0 + 60.0 * np.sin(np.arange(count) / 90.0) + slip)) / 2.0
    pressure_kpa = np.round(16.0 * (90.0 + torque_nm)) / 16.0
    speed_km_h = np.rint(0.03 * turbine)
    columns = {  # a value, and after how many rows it ticks
        "rpm": (turbine + slip, 33),
        "turbine_rpm": (turbine, 1),
        "tcc_slip_rpm": (slip, 1),
        "tcc_desired_slip_rpm": (np.full(count, 20.0), 1),
        "tcc_line_pressure": (pressure_kpa / 6.894757, 1),
        "trans_engine_torque_nm": (torque_nm / 1.355818, 1),
        "delivered_engine_torque_nm": (torque_nm / 1.355818 + rng.normal(0.0, 1.0, count), 33),
        "trans_gear_actual": (gear, 1),
        "output_rpm": (turbine / 1.5, 33),
        "vehicle_speed": (speed_km_h / 1.609344, 2),
        "trans_fluid_temp_c": (32.0 + 1.8 * np.rint(np.linspace(50.0, 61.0, count)), 16),
    }
    lines = [",".join(["time_s", *columns])]
    for row in range(count):
        cells = ["" if row % ticks else f"{values[row]:.10f}" for values, ticks in columns.values()]
        lines.append(f"{0.579 + 0.03 * row:.3f},{','.join(cells)}")
    path.write_bytes(gzip.compress("\n".join([*lines, ""]).encode()))


def test_an_automatic_is_told_its_tier_and_its_units_are_questioned(tmp_path: Path) -> None:
    table, profile = tmp_path / "automatic.csv.gz", tmp_path / "automatic.toml"
    automatic(table)
    run = ended("signals", table)
    assert run.status == 0, run.err
    profile.write_text(run.out, encoding="utf-8")
    assert "it reaches tier 2 (slope of friction of the lock-up clutch over slip, no level)" in run.out
    signals = tomllib.loads(run.out)["signals"]
    assert {signal: (one["column"], one["unit"], one.get("or_unit")) for signal, one in signals.items()} == {
        "engine_torque_nm": ("trans_engine_torque_nm", "lb·ft", "Nm"),
        "turbine_speed_rad_s": ("turbine_rpm", "rpm", None),
        "output_speed_rad_s": ("output_rpm", "rpm", None),
        "lockup_pressure_command_pa": ("tcc_line_pressure", "psi", None),
        "lockup_slip_rad_s": ("tcc_slip_rpm", "rpm", None),
        "lockup_slip_command_rad_s": ("tcc_desired_slip_rpm", "rpm", None),
        "current_gear": ("trans_gear_actual", "", None),
        "sump_temperature_k": ("trans_fluid_temp_c", "degF", "degC"),
        "vehicle_speed_m_s": ("vehicle_speed", "mph", None),
    }
    for question in ("'trans_fluid_temp_c' is questioned", "'trans_engine_torque_nm' is questioned", "in one unit"):
        assert question in run.out
    named: tuple[str | Path, ...] = ("--profile", profile)
    for words in (named, ()):
        run = ended("analyze", table, *words)
        assert run.status == 0
        assert "tier 2 of 3, slope of friction over slip, no level" in run.out + run.err
        assert "lock-up pressure as measured" in run.out + run.err
        assert "of this car's friction only the slope over slip can be known." in run.out
        assert "yet" not in run.out
        assert "column 'trans_fluid_temp_c' is read in 'degF', but something speaks for 'degC'" in run.err


@pytest.fixture(name="car_log", scope="module")
def _car_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the log of a car with 20 gear changes."""
    log = tmp_path_factory.mktemp("car") / "car.log"
    assert emulator(["record", str(log), "--seed", "5", "--cycles", "2"]) == 0
    return log


def test_friction_is_told_from_few_rows_with_wider_intervals(car_log: Path, tmp_path: Path) -> None:
    table, profile = tmp_path / "car.csv", tmp_path / "car.toml"
    written(car_log, table, np.random.default_rng(5), rate_hz=27.0, left_out=OUTPUT - OF_FRICTION)
    profile.write_text(ended("signals", table).out, encoding="utf-8")
    found = analysed(table, "--profile", profile)
    assert [one["kind"] for one in found] == 2 * (5 * ["power_on_upshift"] + 5 * ["coast_downshift"])
    estimates = [one["friction"] for one in found if one["status"] == "valid"]
    assert len(estimates) == 20
    far = [abs(one["mu_c"] - 0.14) / one["std_mu_c"] for one in estimates]
    assert max(far) < 3.0
    assert np.mean(np.array(far) < 2.0) > 0.9
    assert min(one["std_mu_c"] for one in estimates) > 0.0045
    assert not {one["verdict"]["condition"] for one in found} & {"watch", "change_fluid"}


@pytest.mark.parametrize("origin", ["modelled", "without_cut"])
def test_injected_fuel_tells_friction_up_to_a_scale(car_log: Path, tmp_path: Path, origin: str) -> None:
    table, profile = tmp_path / "car.csv", tmp_path / "car.toml"
    written(car_log, table, np.random.default_rng(5), rate_hz=50.0, left_out=OUTPUT - OF_FRICTION)
    with_fuel(table, np.random.default_rng(5))
    proposed = ended("signals", table).out
    assert tomllib.loads(proposed)["signals"]["engine_torque_nm"]["origin"] == "without_cut"
    profile.write_text(proposed.replace('origin = "without_cut"', f'origin = "{origin}"'), encoding="utf-8")
    found: list[dict[str, Any]] = [shift_record(one) for one in diag_service.analyze(table, profile=profile).results]
    shown = ended("analyze", table, "--profile", profile).out
    assert "engine torque is modelled, not measured" in shown
    assert {one["verdict"]["condition"] for one in found} == {"no_verdict"}
    assert all(one["friction"] is one["verdict"]["friction"] is one["verdict"]["level_ratio"] is None for one in found)
    if origin == "without_cut":
        assert [one["reasons"] for one in found] == len(found) * [["torque_unknown"]]
        assert "[torque unknown]" in shown
        return
    used = [one for one in found if one["status"] == "valid"]
    assert len(used) >= 10
    far = [(one["slope"]["mu_s_ratio"] - 0.85) / one["slope"]["std_mu_s_ratio"] for one in used]
    assert np.abs(far).max() < 3.0
    assert {one["slope"]["torque"] for one in used} == {"modelled"}
    last = found[-1]["verdict"]
    assert "engine torque is modelled, not measured: a negative mu-v slope is" in last["reason"]
    assert last["slope"]["mu_s_ratio"] == pytest.approx(0.85, abs=2.0 * last["slope"]["std_mu_s_ratio"])
    assert f"mu_S/mu_C {last['slope']['mu_s_ratio']:.3f}" in shown
    report = tmp_path / "report.html"
    assert ended("report", table, "--profile", profile, "--full", "-o", report).status == 0
    assert "mu_S over mu_C" in report.read_text(encoding="utf-8")


def test_without_torque_the_shifts_of_a_clutch_are_held_against_each_other(car_log: Path, tmp_path: Path) -> None:
    table, profile, page = (tmp_path / f"car.{suffix}" for suffix in ("csv", "toml", "html"))
    rng, inputs = np.random.default_rng(5), {"Input Shaft 1 Speed", "Input Shaft 2 Speed"}
    written(car_log, table, rng, left_out=OF_FRICTION | inputs)
    with_fuel(table, rng)
    profile.write_text(ended("signals", table).out, encoding="utf-8")
    found = diag_service.analyze(table, profile=profile)
    clutches = {one["clutch"]: one for one in found.summary["relative_friction"]}
    upshifts = {clutch: len(one["shifts"]) for clutch, one in clutches.items()}
    assert upshifts == {1: 4, 2: 6}  # under power, of two cycles
    for one in clutches.values():  # the fluid was the same
        assert all(abs(shift["value"] - 1.0) < 3.0 * shift["std"] < 0.6 for shift in one["shifts"].values())
        assert abs(one["trend"]["value"]) < 3.0 * one["trend"]["std"]
    verdicts = found.verdicts.values()
    assert {one.condition.name for one in verdicts} == {"NO_VERDICT"}
    assert all("the torque of the engine is not measured" in (one.advice or "") for one in verdicts)
    shown = ended("analyze", table, "--profile", profile).out
    assert "clutch 2, friction of each power upshift over its others: event " in shown
    assert ended("report", table, "--profile", profile, "--full", "-o", page).status == 0
    assert "Clutch 2: friction in power upshifts, up to a scale that is not known" in page.read_text(encoding="utf-8")


def test_a_table_has_values_and_no_frames_where_it_is_read_and_decoded(tmp_path: Path) -> None:
    (tmp_path / "logs").mkdir()
    tables = [tmp_path / "logs" / f"{name}.csv" for name in ("a", "b")]
    for table in tables:
        rows = (f"{0.1 * row:.1f},{800 + row},{row}" for row in range(30))
        table.write_text("\n".join(("time,Engine RPM (rpm),Vehicle speed (km/h)", *rows, "")), encoding="utf-8")
    whole = ended("decode", tables[0], "-o", tmp_path / "whole")
    assert (whole.status, "frames" in whole.out) == (0, False)
    assert f"{tables[0]}: signals, 60 values: 60 decoded" in whole.out.splitlines()
    each = ended("decode", tables[0].parent, "-o", tmp_path / "each")
    assert (each.status, each.out.count("60 values: 60 decoded"), "frames" in each.out) == (0, 2, False), each
    with read_log(tables[0]) as reader:
        assert sum(map(len, reader)) == 60
        assert reading_text(reader).endswith(" 60 values")
    record = json.loads(ended("decode", tables[0], "-o", tmp_path / "again", "--json").out)
    assert record["frames"]["read"] == 60  # programs know them by this name
    proposed = ended("signals", tables[0])
    assert "# 60 values." in proposed.out.splitlines()
    (tmp_path / "car.toml").write_text(proposed.out, encoding="utf-8")
    for words in (("analyze", tables[0], "--profile", tmp_path / "car.toml"), ("analyze", tables[0].parent)):
        told = ended(*words).out
        assert "60 values" in told, told
        assert "frames" not in told
