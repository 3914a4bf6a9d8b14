"""A third participant that sends frames of others changes no result: they are those of a recording, to the bit."""

import re
import signal
from pathlib import Path

import pytest

from can_silkit_tests.test_simulations import BUS, DRIVE, ended, results
from tests.plugins.silkit import ROOT, Simulations

pytestmark = [pytest.mark.silkit, pytest.mark.slow]

BYSTANDER = ROOT / "can_silkit" / "tests" / "bystander.py"
STARTED = ("--start-time", "1970-01-01")


def simulated(simulations: Simulations, store: Path) -> list[dict[str, object]]:
    """Return the results of a simulation in which others send, too."""
    service = simulations.start("diag-service", "run", *BUS, "--store", str(store), step_s=0.01)
    bystander = simulations.start("python", str(BYSTANDER), "--registry", simulations.uri)
    simulations.begin("ecu-emulator", "diag-service", "bystander")
    ended(simulations.start("ecu-emulator", "run", *BUS, *DRIVE))
    bystander.send_signal(signal.SIGKILL)
    service.send_signal(signal.SIGINT)
    said = ended(service)
    (ignored,) = re.findall(r"(\d+) ignored, 0 rejected, 0 dropped", said)
    assert int(ignored) > 10_000
    return results(store)


def test_frames_of_a_third_participant_change_no_result(simulations: Simulations, tmp_path: Path) -> None:
    log, recorded = tmp_path / "drive.log", tmp_path / "recorded.sqlite"
    ended(simulations.start("ecu-emulator", "record", str(log), *DRIVE, *STARTED))
    ended(simulations.start("diag-service", "analyze", str(log), "--store", str(recorded)))
    assert len(results(recorded)) == 10
    assert simulated(simulations, tmp_path / "live.sqlite") == results(recorded)
