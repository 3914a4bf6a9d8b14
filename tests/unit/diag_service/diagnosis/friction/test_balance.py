"""The linearised balance: its derivatives, its covariance and what both share are those of the residual itself."""

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest

from canlog.arrays import FloatArray
from clutch_model.calibration import nominal_calibration
from diag_service.diagnosis.alignment import GRID_S, AlignedSignals, Resampled, usable_signals
from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.friction import balance as balance_module
from diag_service.diagnosis.friction.balance import (
    LEAST_SECANT,
    Balance,
    Sensitivity,
    add_doubt,
    measurements_of,
    noise_of,
)
from diag_service.diagnosis.friction.drives import SlipWindow, measured_drives, slip_window
from diag_service.diagnosis.friction.evidence import STATE_COUNT, Considered, State
from diag_service.diagnosis.friction.film import VehicleLaws
from diag_service.diagnosis.friction.posterior import Posterior
from ecu_emulator.scenario.scenario import WorkshopRoutine
from tests.support.builders import drive_scenario
from tests.support.shifts_of_a_drive import events_of, in_oil

NOMINAL = nominal_calibration()
GAIN, INERTIA = STATE_COUNT + Considered.TORQUE_GAIN, STATE_COUNT + Considered.ENGINE_INERTIA
LATENCIES = (STATE_COUNT + Considered.TORQUE_LATENCY, STATE_COUNT + Considered.PRESSURE_LATENCY)
MOTORING = STATE_COUNT + Considered.MOTORING_GAIN
MOBILITY = STATE_COUNT + Considered.FILM_MOBILITY

AS_DRIVEN = Posterior.fresh(NOMINAL).known.mean.copy()
"""Parameters of the emulated vehicle, whose readings are not late."""
AS_DRIVEN[[*LATENCIES]] = -NOMINAL.bias.torque_latency_s, -NOMINAL.bias.pressure_latency_s

STEPS = dict(enumerate(0.25 * Posterior.fresh(NOMINAL).known.std()))
"""By which each parameter is moved. The gain of torque is one with inertia, and tested so."""
del STEPS[GAIN]


@lru_cache
def without_noise() -> tuple[Event, ...]:
    base = drive_scenario(seed=5)
    sensors = {name: replace(sensor, noise_std=0.0) for name, sensor in base.sensors.items()}
    return events_of(replace(base, sensors=sensors, routine=WorkshopRoutine(open_revs=1, closed_revs=1)), NOMINAL)[0]


def balance(
    event: Event,
    at: FloatArray = AS_DRIVEN,
    window: SlipWindow | None = None,
    change: Callable[[AlignedSignals], AlignedSignals] = lambda signals: signals,
) -> Balance:
    laws = VehicleLaws.of(NOMINAL).displaced(at)
    signals = usable_signals(event, laws)
    assert isinstance(signals, AlignedSignals)
    signals = change(signals)
    drives = measured_drives(signals, at, None, event.start_ns, laws.packs)
    found = slip_window(signals, drives, laws.packs)
    assert found is not None
    return Balance(signals, window or found[0], drives, laws, at)


@pytest.mark.parametrize(("number", "oil_degc"), [(0, 90.0), (1, 90.0), (0, 40.0), (1, 20.0), (-2, 90.0)])
def test_derivatives_are_those_of_the_residual(number: int, oil_degc: float) -> None:
    event = in_oil(without_noise()[number], oil_degc)
    there = balance(event)
    (seen,) = measurements_of(there, noise_of(there.signals))
    whiten = np.linalg.inv(np.linalg.cholesky(seen.covariance))

    def residual(parameter: int, step: float) -> FloatArray:
        at = AS_DRIVEN.copy()
        at[parameter] += step
        return whiten @ balance(event, at, there.window).residual_nms()

    slower = max(there.film_steps)
    for parameter, step in STEPS.items():
        if parameter == MOBILITY and slower > LEAST_SECANT:  # of a film that yields more slowly: a secant
            told, shown = slower * seen.jacobian[:, parameter], residual(parameter, -slower) - residual(parameter, 0.0)
        else:
            told, shown = (
                2.0 * step * seen.jacobian[:, parameter],
                residual(parameter, -step) - residual(parameter, step),
            )
        most = 0.5 if parameter in LATENCIES else 0.2  # a polynomial has no swings
        assert np.linalg.norm(whiten @ told - shown) < most * np.linalg.norm(shown) + 0.05, parameter


def test_gain_and_inertia_move_the_balance_alike() -> None:
    there = balance(without_noise()[0])
    (seen,) = measurements_of(there, noise_of(there.signals))
    assert seen.overlap is not None
    gain, side = there.laws.bias.torque_gain, there.laws.input_side
    turned_ratio = 1.0 + side.hub_inertia_kg_m2 / side.engine_inertia_kg_m2
    assert gain * seen.jacobian[:, GAIN] == pytest.approx(turned_ratio * seen.jacobian[:, INERTIA])
    assert gain * seen.overlap[GAIN] == pytest.approx(turned_ratio * seen.overlap[INERTIA])


def noisy(event: Event, rng: np.random.Generator) -> Event:
    sensors, columns = NOMINAL.noise, dict(event.columns)
    for std, signals in (
        (sensors.engine_torque_nm, (Signal.ENGINE_TORQUE,)),
        (sensors.engine_speed_rad_s, (Signal.ENGINE_SPEED,)),
        (sensors.hub_speed_rad_s, (Signal.HUB_SPEED,)),
        (sensors.input_speed_rad_s, (Signal.INPUT1_SPEED, Signal.INPUT2_SPEED)),
        (sensors.pressure_pa, (Signal.CLUTCH1_PRESSURE, Signal.CLUTCH2_PRESSURE)),
    ):
        for signal in signals:
            series = columns[signal]
            columns[signal] = replace(series, value=series.value + std * rng.normal(size=len(series.value)))
    return replace(event, columns=columns)


@pytest.mark.parametrize("number", [0, 1, -1])
def test_noise_of_sensors_scatters_the_residual_as_stated(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """And its derivatives share with it what is stated: (31)."""
    monkeypatch.setattr(balance_module, "add_doubt", lambda *_: None)
    event, rng, chi_squares, shared = without_noise()[number], np.random.default_rng(1), [], []
    there = balance(event)
    (plain,) = measurements_of(there, noise_of(there.signals))
    precision = np.linalg.inv(plain.covariance)
    for _ in range(150):
        drawn = balance(noisy(event, rng), window=there.window)
        (seen,) = measurements_of(drawn, noise_of(drawn.signals))
        error = seen.residual - plain.residual
        chi_squares.append(error @ precision @ error / len(error))
        shared.append((seen.jacobian - plain.jacobian)[:, [GAIN, INERTIA, MOTORING]].T @ precision @ error)
    assert np.mean(chi_squares) == pytest.approx(1.0, abs=0.1)
    assert plain.overlap is not None
    error = np.mean(shared, axis=0) - plain.overlap[[GAIN, INERTIA, MOTORING]]
    assert (np.abs(error) <= 4.0 * np.std(shared, axis=0) / np.sqrt(150.0)).all()


def test_what_no_law_holds_is_wrong_one_way_for_a_tenth_of_a_second() -> None:
    there = balance(without_noise()[0])
    sensitivity = Sensitivity(there)
    value, gain = there.weights.value, there.laws.bias.torque_gain
    noises = [np.zeros((band.stop - band.start, band.stop - band.start)) for band in value.bands]
    add_doubt(sensitivity, noises)
    doubt_nm = np.hypot(*[answers.doubt_nm for answers in sensitivity.answers])[value.places[0]]
    opened_nms = 0.5 * gain * np.array([moments.opened for moments in sensitivity.nominal])
    variance = gain**2 * 0.1 / GRID_S * (value.blocks[0] ** 2 @ doubt_nm**2) + (opened_nms**2).sum(axis=0)
    assert np.diag(noises[0]) == pytest.approx(variance, rel=0.05)


def test_samples_are_counted_and_derivatives_found_near_by_are_kept() -> None:
    there = balance(without_noise()[0])
    (piece,), times_s = there.window.pieces, there.signals.engine_torque.times_s
    first_s, last_s = there.signals.grid_s[[piece.first, piece.stop - 1]]
    assert there.sample_count == pytest.approx(np.count_nonzero((times_s > first_s) & (times_s < last_s)), abs=2)
    noise = noise_of(there.signals)
    near = measurements_of(there, noise)
    at = AS_DRIVEN.copy()
    at[State.TORQUE_OFFSET] += 5.0
    ((moved,), (was,)) = measurements_of(balance(without_noise()[0], at, there.window), noise, near), near
    assert moved.jacobian is was.jacobian
    assert not np.allclose(moved.residual, was.residual)


def test_noise_of_one_signal_for_engine_and_hub_is_in_what_both_share_with_the_residual() -> None:
    def of_rows(hub_is_engine: bool) -> Callable[[AlignedSignals], AlignedSignals]:
        def change(signals: AlignedSignals) -> AlignedSignals:
            one = signals.engine_speed
            hub = one if hub_is_engine else Resampled(one.times_s, one.value.copy(), signals.grid_s)
            return replace(signals, hub_speed=hub, row_s=0.04)

        return change

    overlaps = []
    for hub_is_engine in (True, False):
        there = balance(without_noise()[0], change=of_rows(hub_is_engine))
        (seen,) = measurements_of(there, noise_of(there.signals))
        assert seen.overlap is not None
        overlaps.append(seen.overlap[[GAIN, INERTIA]])
    together, apart = overlaps
    assert ((together < 1.1 * apart) & (apart < 0.0)).all()
