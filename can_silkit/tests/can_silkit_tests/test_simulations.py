"""Coordinated virtual time: frames between two processes, emulator and service, and a registry that ends."""

import json
import re
import signal
import sqlite3
import time
from collections.abc import Callable
from pathlib import Path
from subprocess import Popen

import pytest

from tests.plugins.silkit import ROOT, Simulations
from tests.support.patience import HANG_S
from tests.support.ports import free_port
from tests.tools.silkit_partners import STORIES, play

pytestmark = [pytest.mark.silkit, pytest.mark.slow]

BUS = ("-i", "silkit", "-c", "CAN1")
DRIVE = ("--scenario", "noise_only", "--cycles", "1")
OF_A_RUN = ("stream", "produced_at")  # what differs between two runs over the same frames


def test_frames_of_all_kinds_arrive_in_order_with_their_times(simulations: Simulations) -> None:
    exchange = ROOT / "can_silkit" / "tests" / "exchange.py"
    done = simulations.start("python", str(exchange), "--seconds", "3", "--registry", simulations.uri)
    out, err = done.communicate(timeout=HANG_S)
    assert done.returncode == 0, out + err
    result = json.loads(out.splitlines()[-1])
    assert (result["received"], result["different"], result["dropped"]) == (15_000, 0, 0)


def results(store: Path) -> list[dict[str, object]]:
    """Return what a store holds of each shift, but for what names the run."""
    with sqlite3.connect(store) as database:
        rows = database.execute("select json from result order by seq").fetchall()
    kept = [json.loads(text) for (text,) in rows]
    return [{key: value for key, value in shift.items() if key not in OF_A_RUN} for shift in kept]


def ended(program: Popen[str], status: int = 0) -> str:
    """Return what a program has said that ends so."""
    out, err = program.communicate(timeout=HANG_S)
    assert program.returncode == status, out + err
    return out + err


def until(is_reached: Callable[[], bool], driven_by: Popen[str]) -> None:
    """Return when a drive has come so far."""
    deadline_s = time.monotonic() + HANG_S
    while not is_reached():
        assert driven_by.poll() is None
        assert time.monotonic() < deadline_s
        time.sleep(0.01)


def test_results_are_those_of_a_recording_to_the_bit_though_a_registry_ends_and_another_simulation_follows(
    simulations: Simulations, tmp_path: Path
) -> None:
    live, recorded, log, truth = (tmp_path / name for name in ("live.sqlite", "recorded.sqlite", "drive.log", "truth"))
    ended(simulations.start("ecu-emulator", "record", str(log), *DRIVE, "--start-time", "1970-01-01"))
    ended(simulations.start("diag-service", "analyze", str(log), "--store", str(recorded)))
    service = simulations.start("diag-service", "run", *BUS, "--store", str(live), step_s=0.01)
    simulations.begin("ecu-emulator", "diag-service")
    emulator = simulations.start("ecu-emulator", "run", *BUS, *DRIVE, "--json", "--truth", str(truth))
    until(lambda: truth.exists() and '"shift"' in truth.read_text("utf-8"), emulator)
    simulations.end_registry()  # amid the drive: participants go on among themselves
    sent = json.loads(ended(emulator).splitlines()[0])
    assert (sent["frames_given_up"], sent["overruns"], sent["underruns"]) == (0, 0, 0)

    simulations.start_registry()
    simulations.begin("ecu-emulator", "diag-service")
    endless = simulations.start("ecu-emulator", "run", *BUS, "--scenario", "noise_only", "--cycles", "500")
    until(lambda: len(results(live)) > 10, endless)
    service.send_signal(signal.SIGINT)
    said = ended(service)
    assert "the simulation has ended early: " in ended(endless)
    assert "the simulation has ended; waiting for its return" in said
    (count,) = re.findall(r"(\d+) frames, \1 decoded, 0 ignored, 0 rejected, 0 dropped", said)
    assert int(count) > sent["frames_sent"]
    assert len(results(recorded)) == 10
    assert results(live)[:10] == results(recorded)


# The others are variants of these: `python -m tests.tools.silkit_partners` plays all, ten runs each.
@pytest.mark.parametrize("name", ["asks", "crashes", "hangs", "late, stays"])
def test_partners_of_another_make_end_crash_hang_and_join_late(name: str, simulations: Simulations) -> None:
    assert play(STORIES[name], simulations, hang_s=HANG_S).faults == []


def test_a_partner_that_hangs_does_not_keep_one_who_leaves(simulations: Simulations) -> None:
    simulations.begin("ecu-emulator", "diag-service")
    service = simulations.start("diag-service", "monitor", *BUS, step_s=0.01, patience_s=10.0)
    endless = simulations.start("ecu-emulator", "run", *BUS, "--scenario", "noise_only", "--cycles", "500", "--json")
    assert endless.stderr is not None
    while "sending on" not in endless.stderr.readline():
        assert endless.poll() is None
    time.sleep(3.0)  # amid the drive, or before it: it must end in both cases
    endless.send_signal(signal.SIGSTOP)
    service.send_signal(signal.SIGINT)
    out, err = service.communicate(timeout=HANG_S)
    was_late = "ecu-emulator" in err and "is waiting for reply" in err  # it came to join when nobody greeted it
    assert service.returncode == (3 if was_late else 0), out + err
    endless.send_signal(signal.SIGCONT)
    endless.send_signal(signal.SIGINT)
    endless.communicate(timeout=HANG_S)


def test_a_duration_counts_in_the_time_of_the_simulation(simulations: Simulations, tmp_path: Path) -> None:
    log = tmp_path / "drive.log"
    ended(simulations.start("ecu-emulator", "record", str(log), *DRIVE, "--start-time", "1970-01-01"))
    due_s = [float(line[1 : line.index(")")]) for line in log.read_text("ascii").splitlines()]
    simulations.begin("ecu-emulator", "diag-service")
    service = simulations.start("diag-service", "monitor", *BUS, "--duration", "20", step_s=0.01)
    emulator = simulations.start("ecu-emulator", "run", *BUS, *DRIVE)
    (count,) = re.findall(r"(\d+) frames, \1 decoded, 0 ignored", ended(service))
    assert int(count) == sum(t_s < 20.0 for t_s in due_s)
    assert "the simulation has ended early: " in ended(emulator)


def test_a_step_as_long_as_the_cycle_of_the_messages_is_refused(simulations: Simulations) -> None:
    said = ended(simulations.start("ecu-emulator", "run", *BUS, *DRIVE, step_s=0.01), 2)
    assert "a step of 0.01 s is too long: frames leave at whole steps" in said
    assert "at most 0.005 s" in said


def test_without_a_registry_or_a_simulation_it_says_what_to_start(simulations: Simulations) -> None:
    alone = simulations.start("ecu-emulator", "run", *BUS, *DRIVE)
    nowhere = f"silkit://127.0.0.1:{free_port()}"
    nobody = simulations.start("ecu-emulator", "run", *BUS, *DRIVE, registry=nowhere)
    assert f"no SIL Kit registry at {nowhere} takes 'ecu-emulator': silkit-registry" in ended(nobody, 3)
    assert alone.stderr is not None
    said = ""
    while "silkit-system-controller ecu-emulator OTHERS" not in said:
        line = alone.stderr.readline()
        assert line, said
        said += line
    alone.send_signal(signal.SIGINT)
    ended(alone)


def test_a_simulation_that_never_begins_is_said_again_and_again(simulations: Simulations, tmp_path: Path) -> None:
    """Without a system controller nobody can know how long others will need to be there."""
    waiting = simulations.start("diag-service", "run", *BUS, "--once", "--store", str(tmp_path / "car.sqlite"))
    assert waiting.stderr is not None
    said = []
    for line in waiting.stderr:
        said += re.findall(r"the simulation has not begun for (\d+) s; a system controller", line)
        if len(said) == 3:
            break
    assert all(int(since_s) >= 10 * number for number, since_s in enumerate(said, 1)), said
    assert int(said[0]) < int(said[1]) < int(said[2])
    waiting.send_signal(signal.SIGINT)
    ended(waiting)
