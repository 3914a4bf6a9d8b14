"""The service's stages without process, bus or store: frames in, what they say about every shift out."""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from canlog.frames import FrameBatch, join
from canlog.logs import read_log
from clutch_model.calibration import nominal_calibration
from clutch_results.records import ClutchVerdict, ShiftEstimate
from dbc.contract import load_contract
from diag_service.diagnosis.frame_counts import FrameCounts
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from diag_service.service.stages import Diagnosis, Stages
from ecu_emulator.drive.recording import Drive
from fleet_contract import JsonObject
from tests.support.builders import drive_scenario
from tests.support.wire import received


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """What the stages made of a stretch of frames."""

    diagnoses: tuple[Diagnosis, ...]
    counts: FrameCounts

    @property
    def fingerprint(self) -> list[tuple[ShiftEstimate, ClutchVerdict, tuple[JsonObject, JsonObject]]]:
        """Estimate, verdict and state after every shift; equal only if every bit of every number is."""
        return [(diagnosis.estimate, diagnosis.verdict, diagnosis.belief.to_json()) for diagnosis in self.diagnoses]


def frames_of_log(path: Path, duration_s: float) -> FrameBatch:
    """Return the frames of the first seconds of a log."""
    batch = join(list(read_log(path)))
    within = batch.t_ns <= batch.t_ns[0] + round(duration_s * 1e9)
    return batch[: int(within.sum())]


def diagnosed(batches: Iterable[FrameBatch]) -> Outcome:
    """Run fresh stages over batches to the end of the stream."""
    calibration = nominal_calibration()
    decoder = Decoder(load_contract(), load_profile())
    stages = Stages(decoder, calibration)
    found = [diagnosis for batch in batches for diagnosis in stages.feed(batch)]
    found += [stages.conclude(event) for event in stages.flush()]
    return Outcome(diagnoses=tuple(found), counts=stages.decoder.counts)


DRIVE_S = 10.0  # three shifts


@cache
def drive_frames() -> FrameBatch:
    """Return the frames of the first seconds of a drive."""
    return received(next(Drive(drive_scenario("ideal")).stretches(DRIVE_S)).frames)


@cache
def whole_drive() -> Outcome:
    """Return what they say at once."""
    return diagnosed([drive_frames()])
