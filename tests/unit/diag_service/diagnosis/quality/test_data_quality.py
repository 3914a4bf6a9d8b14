"""Quality of the data of a shift: 1 for a sound one, and each flaw costs its own part."""

from collections.abc import Callable
from dataclasses import replace
from datetime import date
from functools import cache, partial

import numpy as np
import pytest

from canlog.arrays import FloatArray, Int64Array, Series
from canlog.e2e.e2e_state import E2eState
from clutch_model.calibration import nominal_calibration
from clutch_results.records import DataQuality, QualityPart, Reason
from dbc.contract import load_contract
from diag_service.diagnosis.columns import BALANCE_SIGNALS, Signal
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.quality import LIMITS, QualityBasis, data_quality, reasons_against
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from diag_service.service.stages import Stages
from ecu_emulator.drive.recording import Drive
from tests.support.builders import drive_scenario
from tests.support.wire import received

CALIBRATION = nominal_calibration()
FRONT = (Signal.WHEEL_FL_SPEED, Signal.WHEEL_FR_SPEED)
REAR = (Signal.WHEEL_RL_SPEED, Signal.WHEEL_RR_SPEED)


@cache
def decoder() -> Decoder:
    return Decoder(load_contract(), load_profile())


def stages() -> Stages:
    fresh = Decoder(load_contract(), load_profile())
    return Stages(fresh, CALIBRATION)


@cache
def sound() -> Event:
    """Return the first shift of a drive with sensor noise."""
    return stages().segment(received(next(Drive(drive_scenario()).stretches(6.0)).frames))[0]


@cache
def basis() -> QualityBasis:
    return QualityBasis(mandatory_messages=decoder().mandatory_messages, scale_ends=decoder().limits)


def with_values(signal: Signal, change: Callable[[FloatArray], FloatArray]) -> Event:
    columns = dict(sound().columns)
    columns[signal] = replace(columns[signal], value=change(columns[signal].value))
    return replace(sound(), columns=columns)


def thinned(keep: Callable[[Series], Int64Array]) -> Event:
    """Return the shift with only some samples of the balance signals."""
    columns = dict(sound().columns)
    for signal in BALANCE_SIGNALS:
        one = columns[signal]
        rows = keep(one)
        columns[signal] = replace(one, t_ns=one.t_ns[rows], sequence=one.sequence[rows], value=one.value[rows])
    return replace(sound(), columns=columns)


def clipped(cut: float, end: float, value: FloatArray) -> FloatArray:
    return np.where(value > cut, end, value)


def part(event: Event, which: QualityPart, on: QualityBasis | None = None) -> float:
    quality = data_quality(event, on or basis())
    assert quality.score == pytest.approx(np.prod(list(quality.parts.values())))
    return quality.parts[which]


def test_a_sound_shift_is_believed_in_full() -> None:
    quality = data_quality(sound(), basis())
    assert quality.parts == dict.fromkeys(set(QualityPart) - {QualityPart.CALIBRATION}, 1.0)
    assert quality.score == 1.0
    assert reasons_against(quality) == ()


@pytest.mark.parametrize(("share", "expected"), [(0.05, 0.875), (0.2, 0.5), (0.5, 0.0)])
def test_lost_frames(share: float, expected: float) -> None:
    def keep(one: Series) -> Int64Array:
        count = len(one.t_ns)
        lost = np.linspace(1, count - 2, round(share * count)).astype(int)
        return np.setdiff1d(np.arange(count), lost)

    assert part(thinned(keep), QualityPart.FRAMES) == pytest.approx(expected, abs=0.09)


@pytest.mark.parametrize(
    ("message", "state", "expected"),
    [
        ("TCU_Pressures", E2eState.INVALID, 0.0),
        ("TCU_Temperature", E2eState.INIT, 0.0),
        ("BRK_WheelSpeeds", E2eState.INVALID, 0.9),
        ("IC_Odometer", E2eState.INIT, 1.0),
    ],
)
def test_messages_that_are_not_valid(message: str, state: E2eState, expected: float) -> None:
    event = replace(sound(), e2e={**sound().e2e, message: state})
    assert part(event, QualityPart.PROTECTION) == pytest.approx(expected)


def test_a_mandatory_message_that_was_never_heard_is_fatal() -> None:
    heard = {name: state for name, state in sound().e2e.items() if name != "TCU_InputSpeeds"}
    quality = data_quality(replace(sound(), e2e=heard), basis())
    assert reasons_against(quality) == (Reason.E2E_INVALID,)


@pytest.mark.parametrize(("late_share", "expected"), [(0.0, 1.0), (0.3, 0.7), (1.0, 0.0)])
def test_late_frames(late_share: float, expected: float) -> None:
    columns = dict(sound().columns)
    for signal in BALANCE_SIGNALS:
        one = columns[signal]
        is_late = np.arange(len(one.t_ns)) > (1.0 - late_share) * len(one.t_ns)
        columns[signal] = replace(one, t_ns=one.t_ns + np.where(is_late, 40_000_000, 0))
    assert part(replace(sound(), columns=columns), QualityPart.TIME) == pytest.approx(expected, abs=0.02)


def test_a_sensor_at_the_end_of_its_scale() -> None:
    low, high = basis().scale_ends[Signal.ENGINE_TORQUE]
    assert low < 0.0 < high
    cut = float(np.quantile(sound().columns[Signal.ENGINE_TORQUE].value, 0.9))
    for end in (low, high):
        event = with_values(Signal.ENGINE_TORQUE, partial(clipped, cut, end))
        assert part(event, QualityPart.SATURATION) < 0.1
    still = with_values(Signal.ENGINE_SPEED, np.zeros_like)
    assert part(still, QualityPart.SATURATION) == 1.0


@pytest.mark.parametrize(
    ("signal", "change"),
    [
        (Signal.OUTPUT_SPEED, lambda value: np.full_like(value, value[0])),
        (Signal.HUB_SPEED, lambda value: value + 4.0),
        (Signal.ENGINE_SPEED, lambda value: value * 1.05),
        (Signal.CLUTCH1_PRESSURE, lambda value: value + 1.2e5),
        (Signal.CLUTCH2_PRESSURE_COMMAND, lambda value: value + 1.2e5),
    ],
)
def test_sensors_that_contradict_each_other(signal: Signal, change: Callable[[FloatArray], FloatArray]) -> None:
    event = with_values(signal, change)
    assert part(event, QualityPart.PLAUSIBILITY) < LIMITS.least_score_ratio
    assert reasons_against(data_quality(event, basis())) == (Reason.IMPLAUSIBLE,)


@pytest.mark.parametrize("slipping", [FRONT, REAR])
def test_tyres_of_one_axle_may_slip(slipping: tuple[Signal, Signal]) -> None:
    """In a hard launch the driven axle turns up to a fifth faster than the other, and with the output."""
    columns = dict(sound().columns)
    for signal in slipping:
        value = columns[signal].value
        columns[signal] = replace(columns[signal], value=value * (1.0 - 0.2 * np.linspace(1.0, 0.0, len(value)) ** 2))
    event = replace(sound(), columns=columns)
    assert part(event, QualityPart.PLAUSIBILITY) == 1.0
    assert reasons_against(data_quality(event, basis())) == ()


@pytest.mark.parametrize(("years", "expected"), [(0, 1.0), (5, 1.0), (10, 0.5), (20, 0.0)])
def test_an_old_calibration(years: int, expected: float) -> None:
    start = date.fromtimestamp(sound().end_ns / 1e9)  # noqa: DTZ012 - only the year counts here
    made = replace(basis(), calibration_date=date(start.year - years, start.month, min(start.day, 28)))
    assert part(sound(), QualityPart.CALIBRATION, made) == pytest.approx(expected, abs=0.01)


def test_flaws_that_pass_alone_may_not_pass_together() -> None:
    parts = {QualityPart.FRAMES: 0.7, QualityPart.TIME: 0.65}
    assert reasons_against(DataQuality(score=0.455, parts=parts)) == (Reason.LOW_DATA_QUALITY,)
    assert reasons_against(DataQuality(score=0.5, parts=parts)) == ()
