"""One drive behind a quick adapter, whose dialogue is made from a recording: the answer that an owner reads."""

from collections.abc import Iterator
from itertools import islice
from pathlib import Path

import numpy as np
import pytest

from canlog.frames import FrameBatch
from diag_service.mapping.profile import load_shipped
from ecu_emulator import Emulator
from ecu_emulator.bus.frames import merge
from ecu_emulator.drive.recording import Drive as Driven
from studies.builders import STRETCH_S, to_batch
from tests.support.asked import dialogue_of, write_candump
from tests.support.in_process import ended
from tests.support.recode import Drive, drive_of, lockup_drive_of

pytestmark = pytest.mark.slow

QUICK_S, USUAL_S = (0.005, 0.03), (0.02, 0.06)  # from a request to its answer; an old ELM327 needs 0.1


def driven(scenario: str, trace: str, duration_s: float) -> Iterator[FrameBatch]:
    """Yield what is said on the bus in the beginning of a drive along a trace."""
    car = Driven(Emulator(scenario, drive=trace, seed=3).scenario)
    for stretch in islice(car.stretches(STRETCH_S), round(duration_s / STRETCH_S)):
        yield to_batch(merge([stretch.frames]))


def asked(folder: Path, drive: Drive, name: str, answer_s: tuple[float, float]) -> Path:
    """Return the log of a tester that asked by a shipped profile all the time."""
    profile, log = load_shipped(name), folder / "asked.log"
    write_candump(log, dialogue_of(drive, profile, np.random.default_rng(1), answer_s=answer_s))
    return log


def test_the_worn_fluid_of_a_dsg_is_to_be_changed_after_one_drive(tmp_path: Path) -> None:
    car = tmp_path / "car.toml"
    log = asked(tmp_path, drive_of(driven("case2", "udds", 780.0)), "vw_dsg", USUAL_S)
    learnt = ended("learn", log, "--profile", "vw_dsg", "-o", car)
    assert learnt.status == 0, learnt.err
    run = ended("analyze", log, "--profile", "vw_dsg", "--vehicle-file", car)
    assert run.status == 0, run.err
    assert "Change the fluid now.\nClutch 1: it can shudder" in run.out
    assert "Why: aged fluid" in run.out


def test_a_gm_automatic_tells_its_slope_after_one_drive_and_why_no_level(tmp_path: Path) -> None:
    log = asked(tmp_path, lockup_drive_of(driven("lockup", "us06", 300.0)), "gm_t87a", QUICK_S)
    run = ended("analyze", log, "--profile", "gm_t87a")
    assert run.status == 0, run.err
    (together,) = [line for line in run.out.splitlines() if "all temperatures" in line]
    assert "rises, positive with 9" in together
    assert "The level of friction is withheld: pressure is commanded" in run.out
    assert "Shudder: none" in run.out
