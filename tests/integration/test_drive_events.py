"""Events that are found on a drive of the emulated car, beside the truth."""

from collections.abc import Sequence
from functools import cache
from itertools import pairwise

from hypothesis import given, settings
from hypothesis import strategies as st

from canlog.frames import FrameBatch
from clutch_model.calibration import nominal_calibration
from clutch_results.event_kinds import EndReason, EventKind
from clutch_results.records import Status
from dbc.contract import load_contract
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.shifts.shifts import DriveFinder
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from ecu_emulator.bus.frames import merge
from ecu_emulator.drive.recording import Drive
from ecu_emulator.truth import EventTruth
from tests.support.chain import Outcome, diagnosed
from tests.support.road import road_scenario, short_trip
from tests.support.wire import START_NS, received

SHAFTS_AND_STATE = {Signal.INPUT1_GEAR, Signal.INPUT2_GEAR, Signal.DRIVE_STATE, Signal.ENGINE_STATE}
LATE_S = 0.02  # two samples


@cache
def driven() -> tuple[FrameBatch, tuple[EventTruth, ...]]:
    """Off to 50 km/h through a few gears, and back to rest."""
    stretches = list(Drive(road_scenario(), planned=iter([short_trip()])).stretches(60.0))
    truths = [truth for stretch in stretches for truth in stretch.truths if isinstance(truth, EventTruth)]
    return received(merge([stretch.frames for stretch in stretches])), tuple(truths)


@cache
def whole() -> Outcome:
    return diagnosed([driven()[0]])


def found(without: frozenset[Signal] = frozenset()) -> list[Event]:
    profile = load_profile()
    decoder = Decoder(load_contract(), profile)
    finder = DriveFinder(decoder.signals - without, nominal_calibration(), decoder.gears)
    events: list[Event] = []
    for batch in decoder.stream(driven()[0]):
        kept = {signal: series for signal, series in batch.columns.items() if signal not in without}
        events += finder.feed(type(batch)(columns=kept, watermark_ns=batch.watermark_ns))
    return events + finder.flush()


def told(truths: Sequence[EventTruth]) -> list[tuple[str, int, int]]:
    """Return kind and gears of what a clutch had work in, or gears changed."""
    return [(one.event, one.from_gear, one.to_gear) for one in truths if one.event != "creep"]


def test_every_event_of_a_drive_is_found_with_its_kind() -> None:
    events = [(one.kind.value, one.from_gear, one.to_gear) for one in found() if one.kind is not EventKind.CREEP]
    assert events == told(driven()[1])


def test_a_car_that_tells_neither_shafts_nor_state_loses_no_event() -> None:
    assert [(one.kind, one.start_ns, one.end_ns) for one in found(frozenset(SHAFTS_AND_STATE))] == [
        (one.kind, one.start_ns, one.end_ns) for one in found()
    ]


def test_a_launch_lies_inside_the_true_one_and_ends_in_lock() -> None:
    (launch,) = (one for one in found() if one.kind is EventKind.LAUNCH)
    (true,) = (one for one in driven()[1] if one.event == "launch")
    first_s, last_s = ((t_ns - START_NS) * 1e-9 for t_ns in (launch.start_ns, launch.end_ns))
    assert launch.end_reason is EndReason.COMPLETE
    assert true.t_start_s - LATE_S < first_s < true.t_start_s + 0.6  # while the clutch is filled nothing slips
    assert abs(last_s - true.t_end_s) < 0.3


def test_a_launch_is_judged_like_a_shift() -> None:
    (launch,) = (one.estimate for one in whole().diagnoses if one.estimate.kind is EventKind.LAUNCH)
    (true,) = (one for one in driven()[1] if one.event == "launch")
    assert (launch.status, launch.reasons, launch.clutch) == (Status.VALID, (), true.clutch)
    assert launch.friction is not None
    assert abs(launch.friction.mu_c - true.mu_c) < 3.0 * launch.friction.std_mu_c
    assert abs(launch.friction.mu_s - true.mu_s) < 3.0 * launch.friction.std_mu_s


@settings(max_examples=3, deadline=None)
@given(st.lists(st.integers(0, 30_000), min_size=1, max_size=40))
def test_cutting_a_drive_anywhere_changes_nothing(places: list[int]) -> None:
    frames = driven()[0]
    edges = [0, *sorted(min(place, len(frames)) for place in places), len(frames)]
    pieces = diagnosed([frames[start:stop] for start, stop in pairwise(edges)])
    assert pieces.fingerprint == whole().fingerprint
    assert pieces.counts == whole().counts
