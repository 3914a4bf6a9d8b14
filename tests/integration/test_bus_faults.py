"""Bus faults from the scenario to the service: what was injected is what is counted, and no estimate is made of it."""

from collections.abc import Iterator
from dataclasses import replace

import pytest

from clutch_model.calibration import nominal_calibration
from clutch_results.records import Status
from dbc.contract import load_contract
from diag_service.diagnosis.frame_counts import FrameCounts
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from diag_service.service.stages import Diagnosis, Stages
from ecu_emulator.drive.recording import frames_of
from ecu_emulator.scenario.faults import BusFault, BusFaultKind, Phase
from ecu_emulator.truth import TruthLog
from studies.builders import to_batch
from tests.support.builders import drive_scenario

MESSAGE = "TCU_Pressures"
SHIFT = 3
BURST_S = 0.2  # twenty transmissions, inside the slip window
FAR_STD = 4.0


def fault(kind: str, **changes: float | str) -> BusFault:
    """Return a fault in the slip window of one shift."""
    given: dict[str, object] = {
        "kind": BusFaultKind(kind),
        "message": MESSAGE,
        "shift": SHIFT,
        "phase": Phase.INERTIA,
        "start_s": 0.1,
        "duration_s": BURST_S,
    }
    return BusFault(**{**given, **changes})  # type: ignore[arg-type]


def analysed(*faults: BusFault, seed: int = 41) -> tuple[list[Diagnosis], FrameCounts, TruthLog]:
    frames, truth = frames_of(replace(drive_scenario(seed=seed), bus_faults=faults))
    calibration = nominal_calibration()
    decoder = Decoder(load_contract(), load_profile())
    stages = Stages(decoder, calibration)
    diagnoses = stages.feed(to_batch(frames))
    counts = stages.decoder.counts
    assert counts.on_bus == len(frames)
    assert counts.on_bus == counts.decoded + counts.ignored + sum(counts.rejected.values())
    return diagnoses, counts, truth


def injected(truth: TruthLog) -> int:
    assert truth.totals is not None
    return sum(one.count for one in truth.totals.faults)


def far(diagnoses: list[Diagnosis], truth: TruthLog) -> Iterator[int]:
    """Yield the shifts whose estimate was given although it is far from the truth."""
    for diagnosis, shift in zip(diagnoses, truth.shifts, strict=True):
        friction = diagnosis.estimate.friction
        if friction is None:
            continue
        off_c, off_s = abs(friction.mu_c - shift.mu_c), abs(friction.mu_s - shift.mu_s)
        if off_c > FAR_STD * friction.random_std_mu_c or off_s > FAR_STD * friction.random_std_mu_s:
            yield shift.number


UNUSABLE = (
    fault("loss"),
    fault("silence", message=""),
    fault("restart"),
    fault("bad_crc"),
    fault("stuck_counter"),
    fault("short"),
    fault("bad_crc", duration_s=0.02),
)


@pytest.mark.parametrize("broken", UNUSABLE, ids=lambda one: f"{one.kind} {one.duration_s} s")
def test_no_estimate_is_made_of_a_window_that_cannot_be_trusted(broken: BusFault) -> None:
    diagnoses, _, _ = analysed(broken)
    hit = diagnoses.pop(SHIFT - 1).estimate
    assert (hit.status, hit.friction) == (Status.REJECTED, None)
    assert hit.reasons
    assert [diagnosis.estimate.status for diagnosis in diagnoses] == [Status.VALID] * 9


@pytest.mark.parametrize(
    ("message", "start_s"), [(MESSAGE, 0.10), (MESSAGE, 0.13), ("ECM_TorqueSpeed", 0.16), ("TCU_InputSpeeds", 0.10)]
)
def test_a_second_sender_bends_no_estimate(message: str, start_s: float) -> None:
    """However its counter stands to that of the first."""
    diagnoses, counts, truth = analysed(fault("spoof", message=message, start_s=start_s))
    assert sum(counts.rejected.values()) >= injected(truth) // 2
    assert list(far(diagnoses, truth)) == []


@pytest.mark.parametrize(("share", "most_rejected"), [(0.01, 0), (0.05, 3)])
def test_random_loss_costs_few_shifts_and_bends_none(share: float, most_rejected: int) -> None:
    lossy = fault("loss", message="", shift=0, start_s=0.0, duration_s=1e6, share=share)
    diagnoses, counts, truth = analysed(lossy, seed=51)
    assert counts.missing == pytest.approx(injected(truth), abs=3)  # a message's last frames leave no trace
    assert list(far(diagnoses, truth)) == []
    assert sum(diagnosis.estimate.status is Status.REJECTED for diagnosis in diagnoses) <= most_rejected
