"""``diag-service try`` before the emulated controller: nothing unless allowed, then values, rate, and how to go on."""

import re
import shlex
import signal
import sys
import time
from collections.abc import Iterator, Mapping
from functools import partial
from pathlib import Path

import can
import pytest

from dbc import DBC_PATH
from tests.integration.test_signal_asking import controller, engine, heard
from tests.integration.test_tester import vehicle
from tests.plugins.asked_services import SentByUs
from tests.support.documents import block_lines
from tests.support.in_process import ended
from tests.support.replay import free_bus
from tests.support.service import Ended, service
from workshop.controller.elm327_server import ElmServer

pytestmark = pytest.mark.asks

TRIALS = 5  # the car may cruise for a while; where the machine is slow, answers may come too late to be samples
SHIFTS = "shift  gears"  # the head of the table of what was found
ANSWERS = 1_200  # frames of the controller: a drive of 13 s, of half a minute where the machine is slow


def test_without_leave_nothing_is_sent() -> None:
    with heard("try-1") as ear:
        run = ended("try", "-i", "virtual", "-c", "try-1", "--listen", "0.05", "--profile", "vw_dsg")
        assert not ear.frames
    assert run.status == 0, run.err
    said = "nothing was heard in 0.05 s\nnothing was sent; --active sends requests by vw_dsg: reading services alone"
    assert run.out == f"{said}; --dry-run shows them byte by byte\n"


def test_a_dry_run_shows_the_requests_byte_by_byte() -> None:
    words = ("--listen", "0.05", "--profile", "vw_dsg", "--active", "--dry-run")
    with heard("try-8") as ear:
        run = ended("try", "-i", "virtual", "-c", "try-8", *words)
        assert not ear.frames
    assert run.status == 0, run.err
    assert "vw_dsg would ask for 100C at 7E1, 380C at 7E1" in " ".join(run.out.split())
    assert "  7E1: 22 10 0C 38 0C 38 0D 38 EB 38 EA\n" in run.out


def test_a_database_that_is_not_there_is_told_before_anything_is_heard() -> None:
    run = ended("try", "-i", "virtual", "-c", "try-9", "--dbc", "nofile", "--active")
    run.assert_one_line(2, "cannot read the database nofile")
    assert not run.out


def test_values_rate_and_how_to_go_on_are_told() -> None:
    with heard("try-2") as ear, vehicle("try-2", controller()):
        run = ended("try", "-i", "virtual", "-c", "try-2", "--listen", "0.05", "--profile", "dct_asked", "--active")
    assert run.status == 0, run.err
    said = " ".join(run.out.split())
    assert "dct_asked fits best: the car answers 6 of 6 values engine torque 120 Nm" in said
    assert "clutch 1 pressure 4 bar" in said
    assert "7 more values are broadcast From these values a drive can tell the friction of both clutches." in said
    assert re.search(r"The values come [0-9.]+ times a second", said)
    assert "diag-service run -i virtual -c try-2 --profile dct_asked --active" in said
    assert ear.services() == {0x22}


def test_a_car_is_not_taken_for_the_bench(tmp_path: Path) -> None:
    """Both profiles ask for the same; what is broadcast tells the difference."""
    path = tmp_path / "car.dbc"
    path.write_text(
        'VERSION ""\nBU_: X\nBO_ 160 Getriebe_11: 8 X\n'
        ' SG_ GE_Zielgang : 0|8@1+ (1,0) [0|15] "" X\n'
        ' SG_ GE_Mom : 4|8@1+ (1,0) [0|1] "" X\n',  # overlaps, as in public databases
        encoding="utf-8",
    )
    words = ("try", "-i", "virtual", "-c", "try-7", "-b", "250000", "--listen", "0.05", "--active")
    with vehicle("try-7", controller(), engine()):
        run = ended(*words, "--dbc", path)
    assert run.status == 0, run.err
    assert "run -i virtual -c try-7 -b 250000 --profile vw_dsg" in " ".join(run.out.split())


def shown(start: str, replaced: Mapping[str, str]) -> Iterator[list[str]]:
    """Yield the words of the page's commands that begin so, with other places than those of the page."""
    for one in block_lines("docs/own-car.md"):
        if one.line.startswith(start):
            line = one.line
            for old, new in replaced.items():
                line = line.replace(old, new)
            yield shlex.split(line)


def test_the_commands_of_the_page_ask_as_it_says() -> None:
    with (
        ElmServer(controller(), ("127.0.0.1", 0), None, engine()) as server,
        vehicle("try-5", controller()),
        heard("try-5") as ear,
    ):
        places = {
            "-i socketcan": "-i virtual",
            "can0": "try-5",
            "vw_mqb.dbc": str(DBC_PATH),
            "/dev/rfcomm0": f"//127.0.0.1:{server.address[1]}",
        }
        commands = [one for one in shown("diag-service try", places) if "--record" not in one]
        assert ["--active" in one for one in commands] == [False, True, True]
        for one in commands:
            run = ended(*one[1:], "--listen", "0.05")
            assert run.status == 0, run.err
            assert ("nothing was sent" in run.out) == ("--active" not in one)
            assert ear.requests() or "--adapter" in one or "--active" not in one
            assert "--active" in one or not ear.requests()
    assert "  clutch 1 pressure 4 bar\n" in run.out


def is_told(log: Path) -> bool:
    return log.exists() and log.read_bytes().count(b" 7E9#") >= ANSWERS


def first_drive(folder: Path) -> tuple[Ended, Path]:
    """Return what a trial of the emulated car said, and the log that it recorded."""
    bus = free_bus()
    places = {"socketcan": "udp_multicast", "vcan0": bus.group}
    (driving,) = shown("ecu-emulator run", places)
    (trying,) = [one for one in shown("diag-service try", places) if bus.group in one]
    emulator = (sys.executable, "-m", "ecu_emulator", *driving[1:])
    with service(folder / "car", program=emulator, variables=bus.variables) as car:
        with can.Bus(bus.group, interface="udp_multicast", port=bus.port, fd=False) as ear:
            car.wait_for(lambda: ear.recv(0.1) is not None)  # its kernels are compiled
        for number in range(TRIALS):
            log = folder / f"try{number}" / "drive.log"
            words = [str(log) if word == log.name else word for word in trying[1:]]
            with service(log.parent, *words, "--listen", "2", variables=bus.variables) as trial:
                while not (is_driving := "drive now" in trial.out) and trial.process.poll() is None:
                    time.sleep(0.05)
                if is_driving:
                    trial.wait_for(partial(is_told, log))
                    trial.send(signal.SIGINT)  # ends the drive, not the program
                if (run := trial.wait()).status == 0 and SHIFTS in run.out:
                    break
    return run, log


def test_a_first_drive_is_recorded_learned_from_and_diagnosed(tmp_path: Path, sent_by_us: SentByUs) -> None:
    run, log = first_drive(tmp_path)
    assert run.status == 0, run.err
    sent_by_us.note_log(log)
    assert sent_by_us.services[0x22] > 100
    said = " ".join(run.out.split())
    learned = log.with_suffix(".vehicle.toml")
    teaching = f"$ diag-service learn {log} --profile dct_asked -o {learned}"
    assert f"{teaching} ± two standard deviations: gear" in said
    assert f"$ diag-service analyze {log} --profile dct_asked --vehicle-file {learned} shift gears" in said
    assert "There is no verdict on the fluid yet" in said
    assert said.endswith(f"--profile dct_asked --vehicle-file {learned} --active")
    times_s = [float(line[1:].split(")")[0]) for line in log.read_text("utf-8").splitlines()]
    assert times_s == sorted(times_s)
    with heard("try-3") as ear:
        refused = ended("try", "-i", "virtual", "-c", "try-3", "--active", "--record", log)
        assert not ear.frames
    assert refused.status == 2
    assert "drive.log" in refused.err
