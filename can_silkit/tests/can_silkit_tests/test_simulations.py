"""Coordinated virtual time: frames between two processes, emulator and service, and a registry that ends."""

import json
import signal
import sqlite3
import time
from pathlib import Path
from subprocess import Popen

import pytest

from tests.plugins.silkit import ROOT, Simulations
from tests.support.patience import HANG_S

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


def drive(simulations: Simulations) -> dict[str, object]:
    """Drive a cycle in a simulation with the service, and return what the emulator says of it."""
    simulations.begin("ecu-emulator", "diag-service")
    emulator = simulations.start("ecu-emulator", "run", *BUS, *DRIVE, "--json")
    out, err = emulator.communicate(timeout=HANG_S)
    assert emulator.returncode == 0, err
    sent: dict[str, object] = json.loads(out)
    return sent


def stopped(service: Popen[str]) -> str:
    """Ask a service to stop, and return what it has said."""
    service.send_signal(signal.SIGINT)
    out, err = service.communicate(timeout=HANG_S)
    assert service.returncode == 0, err
    return out + err


def until_a_shift(emulator: Popen[str], truth: Path) -> None:
    """Return when a shift has been driven."""
    deadline_s = time.monotonic() + HANG_S
    while '"shift"' not in (truth.read_text("utf-8") if truth.exists() else ""):
        assert emulator.poll() is None
        assert time.monotonic() < deadline_s
        time.sleep(0.01)


def test_a_drive_in_virtual_time_gives_the_results_of_its_recording_to_the_bit(
    simulations: Simulations, tmp_path: Path
) -> None:
    live, recorded, log = tmp_path / "live.sqlite", tmp_path / "recorded.sqlite", tmp_path / "drive.log"
    for program, *words in (
        ("ecu-emulator", "record", str(log), *DRIVE, "--start-time", "1970-01-01"),
        ("diag-service", "analyze", str(log), "--store", str(recorded)),
    ):
        done = simulations.start(program, *words)
        _, err = done.communicate(timeout=HANG_S)
        assert done.returncode == 0, err
    service = simulations.start("diag-service", "run", *BUS, "--store", str(live), step_s=0.01)
    sent = drive(simulations)
    said = stopped(service)
    assert (sent["frames_given_up"], sent["overruns"], sent["underruns"]) == (0, 0, 0)
    assert f"{sent['frames_sent']} frames, {sent['frames_sent']} decoded, 0 ignored, 0 rejected, 0 dropped" in said
    assert len(results(live)) == 10
    assert results(live) == results(recorded)


def test_a_registry_may_end_and_a_service_joins_the_next_simulation(simulations: Simulations, tmp_path: Path) -> None:
    service = simulations.start("diag-service", "run", *BUS, "--store", str(tmp_path / "live.sqlite"), step_s=0.01)
    simulations.begin("ecu-emulator", "diag-service")
    emulator = simulations.start("ecu-emulator", "run", *BUS, *DRIVE, "--json", "--truth", str(tmp_path / "truth"))
    until_a_shift(emulator, tmp_path / "truth")
    simulations.end_registry()  # amid the drive: participants go on among themselves
    out, err = emulator.communicate(timeout=HANG_S)
    assert emulator.returncode == 0, err
    simulations.start_registry()
    counts = [json.loads(out)["frames_sent"], drive(simulations)["frames_sent"]]
    said = stopped(service)
    assert "the simulation has ended; waiting for its return" in said
    assert f"{sum(counts)} frames, {sum(counts)} decoded" in said


def test_without_a_registry_or_a_simulation_it_says_what_to_start(simulations: Simulations) -> None:
    alone = simulations.start("ecu-emulator", "run", *BUS, *DRIVE)
    assert alone.stderr is not None
    said = ""
    while "silkit-system-controller ecu-emulator OTHERS" not in said:
        line = alone.stderr.readline()
        assert line, said
        said += line
    alone.send_signal(signal.SIGINT)
    assert alone.wait(timeout=HANG_S) == 0
    simulations.end_registry()
    nobody = simulations.start("ecu-emulator", "run", *BUS, *DRIVE)
    _, err = nobody.communicate(timeout=HANG_S)
    assert nobody.returncode == 3
    assert f"no SIL Kit registry at {simulations.uri} takes 'ecu-emulator': silkit-registry" in err


@pytest.mark.parametrize("is_held", [False, True])
def test_who_is_left_alone_by_the_others_says_so(simulations: Simulations, tmp_path: Path, *, is_held: bool) -> None:
    service = simulations.start("diag-service", "run", *BUS, step_s=0.01)
    simulations.begin("ecu-emulator", "diag-service")
    endless = ("--scenario", "noise_only", "--cycles", "500", "--truth", str(tmp_path / "truth"))
    emulator = simulations.start("ecu-emulator", "run", *BUS, *endless)
    until_a_shift(emulator, tmp_path / "truth")
    if is_held:  # takes no step while the service leaves
        emulator.send_signal(signal.SIGSTOP)
    stopped(service)
    emulator.send_signal(signal.SIGCONT)
    _, err = emulator.communicate(timeout=HANG_S)
    assert emulator.returncode == 3
    assert "frames: the simulation has ended" in err
