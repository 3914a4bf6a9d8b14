"""``diag-service analyze`` as a process: what it prints, keeps, refuses, and how it ends."""

import os
import signal
import sqlite3
from contextlib import closing
from operator import itemgetter
from pathlib import Path

import pytest
from jsonschema import Draft202012Validator

from fleet_contract import schema
from tests.plugins.broker import Mosquitto
from tests.plugins.drives import SHIFT_COUNT
from tests.support.in_process import ended as run
from tests.support.ports import free_port
from tests.support.replay import INTERFACE, free_bus
from tests.support.service import service
from tests.support.subscriber import Subscriber

NOMINAL = Path(__file__).parents[2] / "clutch_model" / "calibrations" / "nominal.toml"


def stored_keys(store: Path) -> list[tuple[str, int]]:
    with closing(sqlite3.connect(store)) as connection:
        return connection.execute("SELECT stream, seq FROM result ORDER BY position").fetchall()


def test_json_lines_are_the_public_records(drive_log: Path) -> None:
    ended = run("analyze", drive_log, "--json", "--vehicle", "car1")
    assert (ended.status, ended.err) == (0, "")
    assert (ended.summary["complete"], ended.summary["incomplete"]) == (True, [])
    for record in ended.shifts:
        Draft202012Validator(schema("shift")).validate(record)
    for clutch in ended.summary["clutches"]:
        Draft202012Validator(schema("clutch")).validate(clutch)
    assert [record["seq"] for record in ended.shifts] == list(range(1, SHIFT_COUNT + 1))
    assert {record["status"] for record in ended.shifts} == {"valid"}
    frames = ended.summary["frames"]
    assert frames["on_bus"] == len(drive_log.read_text(encoding="ascii").splitlines())
    assert frames["on_bus"] == frames["decoded"] + frames["ignored"] + sum(frames["rejected"].values())


def test_the_same_log_twice_is_stored_once(drive_log: Path, tmp_path: Path) -> None:
    arguments = ("analyze", drive_log, "--json", "--store", tmp_path / "car.sqlite")
    first, second = (run(*arguments) for name in ("first", "second"))
    assert first.shifts == second.shifts
    assert (first.summary["shifts"]["stored"], second.summary["shifts"]["stored"]) == (SHIFT_COUNT, 0)
    assert second.summary["shifts"]["already_stored"] == SHIFT_COUNT
    assert len(stored_keys(tmp_path / "car.sqlite")) == SHIFT_COUNT


def test_logs_of_one_drive_are_put_in_order(drive_log: Path, tmp_path: Path) -> None:
    lines = drive_log.read_bytes().splitlines(keepends=True)
    (tmp_path / "a.log").write_bytes(b"".join(lines[len(lines) // 2 :]))
    (tmp_path / "b.log").write_bytes(b"".join(lines[: len(lines) // 2]))
    whole = run("analyze", drive_log, "--json")
    parts = run("analyze", tmp_path / "a.log", tmp_path / "b.log", "--json")
    assert parts.shifts == whole.shifts  # the stream's name included: it is the contents', in order


def test_damage_in_a_log_is_counted_and_told(drive_log: Path, tmp_path: Path) -> None:
    lines = drive_log.read_text(encoding="ascii").splitlines()
    crc_spoilt = [line[:-1] + ("0" if line[-1] != "0" else "1") for line in lines[100:110]]
    log = tmp_path / "damaged.log"
    log.write_text("\n".join([*lines[:100], *crc_spoilt, "what is this", *lines[110:]]) + "\n", encoding="ascii")
    ended = run("analyze", log, "--json")
    assert ended.status == 0
    assert ended.summary["frames"]["rejected"]["bad_crc"] == len(crc_spoilt)
    assert ended.summary["frames"]["unreadable"] == {"malformed": 1}
    assert "damaged.log: 1 pieces of the log are not frames" in ended.err
    assert ended.err.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "status", "text"),
    [
        (("analyze",), 2, "missing argument 'LOG"),
        (("analyse", "{log}"), 2, "no such command"),
        (("analyze", "{log}", "{log}"), 2, "given twice"),
        (("analyze", "{log}", "--vehicle", "a/b"), 2, "vehicle id"),
        (("analyze", "{log}", "--calibration", "{tmp}/range.toml"), 2, "mu_c must be 0.02..0.5"),
        (("analyze", "{log}", "--dbc", "{tmp}/none.dbc"), 2, "none.dbc"),
        (("analyze", "{log}", "--dbc", "{tmp}/foreign.dbc"), 2, "no message ECM_TorqueSpeed"),
        (("analyze", "{tmp}/empty.log"), 3, "empty.log"),
        (("analyze", "{tmp}/empty"), 2, "holds no log"),
        (("inspect", "{tmp}/empty"), 2, "holds no log that can be read"),
        (
            ("decode", "{log}", "-o", "{tmp}/x.log"),
            2,
            "parquet, csv, jsonl or arrow (--format; from Python table_format)",
        ),
        (("analyze", "{tmp}/pipe"), 3, "it is a pipe, not a plain file"),
        (("analyze", "{log}", "--dbc", "/dev/zero"), 2, "it is a device"),
        (("analyze", "{log}", "--store", "{tmp}/garbage.log"), 4, "not a database"),
    ],
)
def test_what_cannot_be_used_is_told_in_one_line(
    drive_log: Path, tmp_path: Path, arguments: tuple[str, ...], status: int, text: str
) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty.log").touch()
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "garbage.log").write_bytes(bytes(range(256)) * 40)
    (tmp_path / "foreign.dbc").write_text('VERSION ""\nBU_: A\nBO_ 1 M: 8 A\n SG_ S : 0|8@1+ (1,0) [0|255] "" A\n')
    (tmp_path / "range.toml").write_text(NOMINAL.read_text(encoding="utf-8").replace("mu_c = 0.14", "mu_c = 1.4"))
    filled = [argument.format(log=drive_log, tmp=tmp_path) for argument in arguments]
    run(*filled).assert_one_line(status, text)


def test_a_second_service_leaves_the_store_alone(drive_log: Path, tmp_path: Path) -> None:
    store = tmp_path / "car.sqlite"
    bus = free_bus()
    arguments = ("run", "-i", INTERFACE, "-c", bus.group, "--store", store)
    with service(tmp_path / "first", *arguments, variables=bus.variables) as first:
        first.wait_for(lambda: "listening" in first.out)
        second = run("analyze", drive_log, "--store", store)
        second.assert_one_line(4, f"in use by another diag-service (process {first.process.pid})")
        first.send(signal.SIGTERM)
        assert first.wait().status == 0
    assert run("analyze", drive_log, "--store", store).status == 0


@pytest.mark.broker
def test_results_reach_a_broker(drive_log: Path, tmp_path: Path, broker: Mosquitto) -> None:
    with Subscriber(broker.port) as subscriber:
        ended = run("analyze", drive_log, "--json", "--vehicle", "car1", "--broker", broker.url)
        assert (ended.status, ended.summary["shifts"]["unpublished"]) == (0, 0)
        subscriber.wait(lambda heard: len(heard.payloads("car1/shift")) == SHIFT_COUNT)
        # What was stored before the connection began is sent behind what comes meanwhile.
        assert sorted(subscriber.payloads("car1/shift"), key=itemgetter("seq")) == ended.shifts


@pytest.mark.broker
def test_results_without_a_broker_wait_in_the_store(drive_log: Path, tmp_path: Path, broker: Mosquitto) -> None:
    arguments = ("analyze", drive_log, "--json", "--vehicle", "car1", "--store", tmp_path / "car.sqlite")
    absent = run(*arguments, "--broker", f"mqtt://127.0.0.1:{free_port()}")
    assert (absent.status, absent.summary["shifts"]["unpublished"]) == (0, SHIFT_COUNT)
    assert absent.err.count("warning") == 1
    with Subscriber(broker.port) as subscriber:
        present = run(*arguments, "--broker", broker.url)
        assert (present.status, present.err, present.summary["shifts"]["unpublished"]) == (0, "", 0)
        subscriber.wait(lambda heard: len(heard.payloads("car1/shift")) == SHIFT_COUNT)
        assert subscriber.payloads("car1/shift") == absent.shifts
