"""Shifts of one emulated drive, found once: what tests of single stages begin with."""

from collections.abc import Callable
from dataclasses import replace
from functools import cache

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import Calibration
from clutch_model.units import k_from_degc
from dbc.contract import load_contract
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.shifts.run_ups import RunUpFinder
from diag_service.diagnosis.shifts.shifts import ShiftFinder
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from ecu_emulator.drive.recording import Drive, frames_of
from ecu_emulator.scenario.scenario import Scenario
from studies.builders import to_batch
from tests.support.builders import drive_scenario
from tests.support.wire import received


@cache
def first_shifts() -> tuple[Event, ...]:
    """Return the shifts in the first 12 s of a drive with sensor noise: 1-2 and 2-3 at least."""
    decoder, finder = Decoder(load_contract(), load_profile()), ShiftFinder()
    batch = received(next(Drive(drive_scenario()).stretches(12.0)).frames)
    return tuple(event for columns in decoder.feed(batch) for event in finder.feed(columns))


def events_of(scenario: Scenario, calibration: Calibration) -> tuple[tuple[Event, ...], tuple[Event, ...]]:
    """Return all shifts and all run-ups of a drive."""
    frames, _ = frames_of(scenario)
    decoder, shift_finder, run_up_finder = (
        Decoder(load_contract(), load_profile()),
        ShiftFinder(),
        RunUpFinder(calibration),
    )
    shifts: list[Event] = []
    run_ups: list[Event] = []
    for columns in decoder.feed(to_batch(frames)):
        shifts += shift_finder.feed(columns)
        run_ups += run_up_finder.feed(columns)
    return tuple(shifts + shift_finder.flush()), tuple(run_ups + run_up_finder.flush())


def changed(event: Event, signal: Signal, change: Callable[[FloatArray, FloatArray], FloatArray]) -> Event:
    """Return the shift with one signal's values changed by a function of time since its start [s] and value."""
    series = event.columns[signal]
    value = change((series.t_ns - event.start_ns) * np.float64(1e-9), series.value)
    return replace(event, columns={**event.columns, signal: replace(series, value=value)})


def thinned(event: Event, signal: Signal, lost: slice) -> Event:
    """Return the shift without some samples of one signal."""
    series = event.columns[signal]
    rows = np.delete(np.arange(len(series.t_ns)), lost)
    kept = replace(series, t_ns=series.t_ns[rows], sequence=series.sequence[rows], value=series.value[rows])
    return replace(event, columns={**event.columns, signal: kept})


def without(event: Event, signal: Signal) -> Event:
    """Return the shift on a bus that lacks a signal."""
    return replace(event, columns={one: series for one, series in event.columns.items() if one is not signal})


def in_oil(event: Event, degc: float) -> Event:
    """Return an event with another oil temperature."""
    oil = event.columns[Signal.SUMP_TEMPERATURE]
    cold = replace(oil, value=np.full(len(oil.value), k_from_degc(degc)))
    return replace(event, columns={**event.columns, Signal.SUMP_TEMPERATURE: cold})
