"""Owners of cars, from plug-in to answer: each story ends in a verdict, or in a clear no before the drive."""

import re
import socket
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from ecu_emulator import Emulator
from tests.integration.test_signal_asking import controller, engine, heard
from tests.support.in_process import ended
from tests.support.patience import HANG_S
from tests.support.ports import free_port
from workshop.controller.answers import Answers
from workshop.controller.controller import Controller
from workshop.controller.elm327_server import ElmServer
from workshop.tester import trying

pytestmark = pytest.mark.asks

TRIALS = 5  # on a machine that is far too slow for an adapter
DRIVEN_S = "6"
NEXT_STEP = "switch the ignition on, check plug and bit rate, and try again"


@contextmanager
def car(like: str, scenario: str, drive: str) -> Iterator[str]:
    """Yield the adapter of a car that drives."""
    with Emulator(scenario, drive=drive, is_endless=True, answers=Answers(like=like, elm327="127.0.0.1:0")) as emulator:
        deadline_s = time.monotonic() + HANG_S
        while not emulator.sent_s:
            assert emulator.is_driving
            assert time.monotonic() < deadline_s
            time.sleep(0.05)
        (place,) = re.findall(r"ELM327 adapter at (\S+)", " ".join(emulator.notices))
        yield f"elm327://{place}"


def story(folder: Path, profile: str, like_car: tuple[str, str, str]) -> tuple[str, Path]:
    """Return what an owner reads, who plugs an adapter in and drives, and the log."""
    with car(*like_car) as adapter:
        for number in range(TRIALS):
            log = folder / f"drive{number}.log"
            words = ("--adapter", adapter, "--profile", profile, "--active", "--duration", DRIVEN_S)
            run = ended("try", *words, "--record", log)
            if "too slow for any drive" not in run.err:
                break
    assert run.status == 0, run.err
    return " ".join(run.out.split()), log


def test_a_dsg_and_an_elm327_from_plug_in_to_verdict(tmp_path: Path) -> None:
    said, log = story(tmp_path, "vw_dsg", ("vw_dsg", "case2", "cycle"))
    assert "9 of 9 signals are told; tier 1 (friction)" in said
    assert "speeds, torque, pressures at" in said
    assert "no verdict on level, clutch 2 unknown" in said
    assert f"$ diag-service analyze {log} --profile vw_dsg" in said
    assert "There is no verdict on the fluid yet." in said
    again = ended("analyze", log, "--profile", "vw_dsg")
    assert again.status == 0, again.err
    assert "0 rejected" in again.out


def test_a_gm_automatic_and_an_elm327_from_plug_in_to_verdict(tmp_path: Path) -> None:
    said, log = story(tmp_path, "gm_t87a", ("gm_t87a", "lockup", "udds"))
    assert "6 of 6 signals are told; tier 2 (slope of friction of the lock-up clutch over slip, no level)" in said
    assert "slope of friction of the lock-up clutch over slip, no level; no shudder" in said
    assert f"$ diag-service analyze {log} --profile gm_t87a" in said
    assert "needs lockup_pressure_pa as measured" in said
    assert log.stat().st_size


def only_speeds() -> Controller:
    """Return a transmission that tells speeds and temperature to whoever asks."""
    transmission = controller()
    data = {
        number: datum for number, datum in transmission.table.data.items() if number not in {0x100C, 0x38EB, 0x38EA}
    }
    transmission.table = replace(transmission.table, data=data)
    return transmission


def test_a_car_that_tells_speeds_alone_is_refused_before_the_drive(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(trying, "RATE_S", 1.0)
    log = tmp_path / "drive.log"
    with ElmServer(only_speeds(), ("127.0.0.1", 0), None, engine()) as server:
        words = ("--adapter", f"elm327://{server.place}", "--profile", "vw_dsg", "--active", "--record", log)
        run = ended("try", *words)
    assert run.status == 3
    assert "drive now" not in run.out
    assert not log.exists()
    assert "no drive tells anything of friction; friction needs engine_torque_nm" in run.err
    assert "clutch1_pressure_pa" in run.err


def test_an_absent_adapter_is_told_with_the_next_step() -> None:
    run = ended("try", "--adapter", f"elm327://127.0.0.1:{free_port()}", "--active")
    run.assert_one_line(3, "Connection refused: is it plugged in, switched on and paired, and is that its port?")
    ended("try", "--adapter", "elm327:/dev/nobody", "--active").assert_one_line(3, "is it plugged in")


def test_an_adapter_that_says_nothing_is_told_with_the_next_step() -> None:
    with socket.create_server(("127.0.0.1", 0)) as silent:
        run = ended("try", "--adapter", f"elm327://127.0.0.1:{silent.getsockname()[1]}", "--active")
    run.assert_one_line(3, "does not answer: is it plugged in, switched on and paired, and is that its port?")


def test_a_silent_car_behind_an_adapter_is_told_with_the_next_step() -> None:
    elsewhere = controller()
    elsewhere.table = replace(
        elsewhere.table, addressing=replace(elsewhere.table.addressing, request_id=0x7E5, response_id=0x7ED)
    )
    with ElmServer(elsewhere, ("127.0.0.1", 0)) as server:
        run = ended("try", "--adapter", f"elm327://{server.place}", "--active")
    run.assert_one_line(3, f"nobody answers at 7E0, 7E1, 7E2: {NEXT_STEP}")
    assert server.counts.lines < 40  # each controller is asked three times, whatever the number of profiles


def test_a_sleeping_bus_is_told_with_the_next_step() -> None:
    with heard("owner-sleeps") as ear:
        run = ended("try", "-i", "virtual", "-c", "owner-sleeps", "--active")
    run.assert_one_line(3, f"nothing is said on the bus, and nobody answers at 7E0, 7E1, 7E2: {NEXT_STEP}")
    assert len(ear.frames) == 9
