"""What the live update after each event of a drive takes in one version of this project.

Run by its path, so that the packages it measures are those of the folder that PYTHONPATH names:

    PYTHONPATH=FOLDER python -P timed_events.py DRIVE
    PYTHONPATH=FOLDER python -P timed_events.py

With a drive it prints one line of JSON: by kind of event, the least processor time [s] of each one over some rounds.
Without one it answers each line of its input with such a line about one round of the shift cycle: processor times [s]
of a shift in the mean, live update and full solve.
"""

import json
import sys
import time
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import replace

from studies.accuracy import to_batch
from clutch_model.calibration import nominal_calibration
from dbc.contract import load_contract
from diag_service.diagnosis.condition.condition import ConditionMemory
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.friction import Posterior
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from diag_service.service.stages import Stages
from ecu_emulator.drive.recording import frames_of
from ecu_emulator.scenario.drive_names import DriveName
from ecu_emulator.scenario.scenario_file import load_scenario

ROUNDS = 5

Times = dict[str, list[float]]
"""By kind of event, the time of each one [s]."""


def new_stages() -> Stages:
    """Return all stages, before their first frame."""
    calibration = nominal_calibration()
    decoder = Decoder(load_contract(), load_profile())
    return Stages(decoder, calibration, Posterior.fresh(calibration), ConditionMemory.fresh())


def times_of(name: DriveName) -> Times:
    """Return the live update's times after each event of a drive; what is not compiled is compiled before."""
    frames, _ = frames_of(replace(load_scenario("ideal"), drive=name))
    events = [*(stages := new_stages()).segment(to_batch(frames)), *stages.flush()]
    one_round_s(events)
    rounds_s = [one_round_s(events) for _ in range(ROUNDS)]
    best_s: defaultdict[str, list[float]] = defaultdict(list)
    for event, *times_s in zip(events, *rounds_s, strict=True):
        best_s[event.kind.value].append(min(times_s))
    return best_s


def one_round_s(events: Sequence[Event]) -> list[float]:
    """Return the processor time of each event's live update [s]."""
    stages, times_s = new_stages(), list[float]()
    for event in events:
        began_s = time.process_time()
        stages.conclude(event)
        times_s.append(time.process_time() - began_s)
    return times_s


def answer_rounds() -> None:
    """Time the shifts of the cycle once for each line of the input."""
    batch = to_batch(frames_of(load_scenario("ideal"))[0])
    events = [*(stages := new_stages()).segment(batch), *stages.flush()]
    one_round_s(events)
    for _ in sys.stdin:
        live_s, stages = sum(one_round_s(events)), new_stages()
        began_s = time.process_time()
        stages.feed(batch)
        full_s = time.process_time() - began_s
        sys.stdout.write(json.dumps([live_s / len(events), full_s / len(events)]) + "\n")
        sys.stdout.flush()


if __name__ == "__main__":
    if len(sys.argv) > 1:
        sys.stdout.write(json.dumps(times_of(DriveName(sys.argv[1]))) + "\n")
    else:
        answer_rounds()
