"""Owners of cars, from plug-in to answer: each story ends in a verdict, or in a clear no before the drive."""

import re
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import replace
from pathlib import Path

import can
import pytest

from diag_service.mapping.profile import load_shipped
from ecu_emulator import Emulator
from tests.integration.test_signal_asking import VALUES, Canned, controller, engine, heard, wait_for
from tests.integration.test_tester import vehicle
from tests.support.in_process import ended
from tests.support.patience import HANG_S
from tests.support.ports import free_port
from workshop.controller.answers import Answers
from workshop.controller.controller import Controller
from workshop.controller.elm327_server import ElmServer
from workshop.controller.services.data import STARTING

pytestmark = pytest.mark.asks

TRIALS = 5  # on a machine that is far too slow for an adapter
DRIVEN_S = "6"
SI_NAME = re.compile(r"\b\w+_(?:rad_s|nm|pa|m_s|k|ratio|gear)\b")
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


SLOW = (
    r"The values come [1-4](\.[0-9])? times a second: only slow starts from standstill can be judged, in which the "
    r"clutch slips for [0-9.]+ s. From the third drive on you learn whether the friction of clutch 1 changes, but not "
    r"how good it is. Clutch 2 stays unknown. A faster adapter tells more."
)


@pytest.mark.parametrize("like", ["vw_dsg", "bmw_dkg"])
def test_a_dual_clutch_and_an_elm327_from_plug_in_to_verdict(tmp_path: Path, like: str) -> None:
    said, log = story(tmp_path, like, (like, "case2", "cycle"))
    assert said.startswith(f"{like} fits best: the car answers 9 of 9 values ")
    assert "From these values a drive can tell the friction of both clutches." in said
    assert re.search(SLOW, said)
    assert "drive now, through all gears, accelerating and rolling" in said
    assert f"$ diag-service analyze {log} --profile {like}" in said
    assert "There is no verdict on the fluid yet." in said
    assert not SI_NAME.findall(said)
    again = ended("analyze", log, "--profile", like)
    assert again.status == 0, again.err
    assert "0 rejected" in again.out


def test_a_gm_automatic_and_an_elm327_from_plug_in_to_verdict(tmp_path: Path) -> None:
    """Its drive is judged as one of a lock-up clutch, as the command by hand judges it."""
    said, log = story(tmp_path, "gm_t87a", ("gm_t87a", "lockup", "udds"))
    assert said.startswith("gm_t87a fits best: the car answers 6 of 6 values turbine speed ")
    assert (
        "From these values a drive can tell whether friction of the lock-up clutch rises with slip (good) or falls (it "
        "can shudder). How good the friction is stays unknown: the car tells the commanded pressure, not the measured "
        "one."
    ) in said
    assert "times a second. Shudder itself is too fast for that: it takes 25 times a second." in said
    words = ("analyze", str(log), "--profile", "gm_t87a", "--calibration", "lockup")
    by_hand = ended(*words)
    assert f"$ diag-service {' '.join(words)} {' '.join(by_hand.out.split())}" in said
    assert "Lock-up clutch, torque at fixed pressure for 10 rpm more slip" in said
    assert said.endswith("--profile gm_t87a --calibration lockup --active")
    assert "$ diag-service learn" not in said
    assert not SI_NAME.findall(said)


def test_a_lockup_clutch_is_not_learned_as_a_dual_clutch(tmp_path: Path) -> None:
    log, car = tmp_path / "drive.log", tmp_path / "car.toml"
    log.write_text("(1767225600.000000) can0 7E2#0322194100000000\n", encoding="ascii")
    run = ended("learn", log, "--profile", "gm_t87a", "-o", car)
    assert run.status == 2
    assert run.err.endswith("for a lock-up clutch, analyze takes --calibration lockup\n")
    assert not car.exists()


def only_speeds() -> Controller:
    """Return a transmission that tells speeds and temperature to whoever asks."""
    transmission = controller()
    data = {
        number: datum for number, datum in transmission.table.data.items() if number not in {0x100C, 0x38EB, 0x38EA}
    }
    transmission.table = replace(transmission.table, data=data)
    return transmission


def test_a_car_that_tells_speeds_alone_is_refused_before_the_drive(tmp_path: Path) -> None:
    log = tmp_path / "drive.log"
    with ElmServer(only_speeds(), ("127.0.0.1", 0), None, engine()) as server:
        words = ("--adapter", f"elm327://{server.place}", "--profile", "vw_dsg", "--active", "--record", log)
        run = ended("try", *words)
    assert "vw_dsg fits best: the car answers 6 of 9 values\n" in run.out
    assert "\n  refused: engine torque, clutch 1 pressure, clutch 2 pressure\n" in run.out
    assert "drive now" not in run.out
    assert not log.exists()
    run.assert_one_line(
        3,
        "no drive would tell anything of friction: it also takes engine torque, clutch 1 pressure, clutch 2 pressure, "
        "and this car does not answer for them. A profile of your own may ask in another way: --profile names it",
    )


def test_the_answers_of_profiles_that_do_not_matter_are_shown_by_an_option() -> None:
    with ElmServer(controller(), ("127.0.0.1", 0), None, engine()) as server:
        words = ("try", "--adapter", f"elm327://{server.place}", "--active")
        short, long = ended(*words), ended(*words, "-v")
    assert short.out.startswith("vw_dsg fits best: ")
    assert len(short.out.splitlines()) == 14
    assert "other profiles tell less: bmw_dkg (1 of 9), dct_asked (6 of 6), gm_t87a (0 of 6); -v shows" in short.out
    assert "\n  engine torque: refused, request out of range (31) (0086 at 7E1)\n" in long.out
    assert "\n  turbine speed: no answer (1941 at 7E2)\n" in long.out


BUSY = "7E1 is busy: it is asked again for"


def busy_car(channel: str, starts_after_s: float | None) -> AbstractContextManager[object]:
    """Return a car whose controllers know no value yet, as while an emulated car compiles; None: they never will."""
    values: dict[str, float] = {STARTING: 1.0}
    if starts_after_s is not None:
        threading.Timer(starts_after_s, lambda: (values.update(VALUES), values.pop(STARTING))).start()
    return vehicle(channel, controller(values), engine(values))


def test_a_car_that_is_starting_is_waited_for() -> None:
    with busy_car("owner-starts", starts_after_s=2.0):
        run = ended("try", "-i", "virtual", "-c", "owner-starts", "--listen", "0.05", "--profile", "vw_dsg", "--active")
    assert run.status == 0, run.err
    assert f"{BUSY} 60 s at most\n" in run.out
    assert "vw_dsg fits best: the car answers 9 of 9 values\n" in run.out
    assert "refused" not in run.out


def test_a_car_that_is_silent_while_it_is_busy_is_waited_for() -> None:
    """As an emulated car, whose compiler leaves its controller no time for answers."""
    channel, words = "owner-silent", ("--listen", "0.05", "--profile", "dct_asked", "--active")
    requests = [f"22{asked.number:04X}" for asked in load_shipped("dct_asked").asked.values()]
    with can.Bus(channel, "virtual") as near:
        canned = Canned(near, dict.fromkeys(requests, ("03 7F 22 21",)))

        def start() -> None:
            wait_for(lambda: canned.begun_count >= 2)
            canned.answers.clear()
            wait_for(lambda: canned.begun_count >= 8)
            canned.answers |= {request: (f"05 62 {request[2:]} 01 90",) for request in requests}

        starting = threading.Thread(target=start)
        with can.Notifier(near, [canned], timeout=0.05):
            starting.start()
            run = ended("try", "-i", "virtual", "-c", channel, *words)
            starting.join()
    assert "dct_asked fits best: the car answers 6 of 6 values\n" in run.out


def test_what_a_controller_leaves_unanswered_does_not_end_the_questions() -> None:
    channel, words = "owner-partly", ("--listen", "0.05", "--profile", "dct_asked", "--active")
    *requests, last = [f"22{asked.number:04X}" for asked in load_shipped("dct_asked").asked.values()]
    with can.Bus(channel, "virtual") as near:
        answered = {request: (f"05 62 {request[2:]} 01 90",) for request in (requests[0], last)}
        with can.Notifier(near, [Canned(near, answered)], timeout=0.05):
            run = ended("try", "-i", "virtual", "-c", channel, *words)
    assert "dct_asked fits best: the car answers 2 of 6 values\n" in run.out
    assert "  no answer: input shaft 1 speed, input shaft 2 speed, clutch 1 pressure, clutch 2 pressure\n" in run.out


def test_a_car_that_stays_busy_is_called_busy() -> None:
    words = ("--listen", "0.05", "--patience", "0.5", "--active")
    with busy_car("owner-busy", starts_after_s=None):
        run = ended("try", "-i", "virtual", "-c", "owner-busy", *words)
    next_step = "it may be starting: wait a minute with the ignition on, and try again"
    run.assert_one_line(3, f"stayed busy for 0.5 s; {next_step}")
    assert "refused" not in run.out


def test_a_car_that_asks_for_time_for_ever_is_called_so() -> None:
    channel, words = "owner-pending", ("--listen", "0.05", "--patience", "0", "--profile", "dct_asked", "--active")
    with can.Bus(channel, "virtual") as near:
        answers = {asked.data_id: ("03 7F 22 78",) for asked in load_shipped("dct_asked").asked.values()}
        canned = Canned(near, {f"22{datum.number:04X}": frames for datum, frames in answers.items()})
        with can.Notifier(near, [canned], timeout=0.05):
            run = ended("try", "-i", "virtual", "-c", channel, *words)
    assert run.status == 3
    assert "7E1 asked for more time, and never answered; it may be starting: wait a minute" in run.err.splitlines()[-1]


def test_a_car_that_refuses_all_says_who_answers() -> None:
    with vehicle("owner-refuses", controller()):
        words = ("--listen", "0.05", "--profile", "bmw_dkg", "--active")
        run = ended("try", "-i", "virtual", "-c", "owner-refuses", *words)
    run.assert_one_line(3, "7E1 answers, but tells nothing that a profile asks for: --profile names one of your own")


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
