"""Builders of records for tests: sound values, of which a test changes what it is about."""

from dataclasses import replace
from typing import Any

from clutch_model.calibration import clutch_of_gear, nominal_calibration
from clutch_results.records import (
    ClutchRatio,
    ClutchVerdict,
    Condition,
    DataQuality,
    EventConditions,
    EventFit,
    FrictionEstimate,
    FrictionTrend,
    QualityPart,
    ScaleFreeFriction,
    ShiftEstimate,
    ShiftResult,
    ShiftScatter,
    Status,
)
from diag_service.diagnosis.condition.verdict import advice
from diag_service.diagnosis.friction.evidence import STATE_COUNT, Considered, Evidence, JudgedEvent
from diag_service.diagnosis.friction.posterior import Posterior
from ecu_emulator.scenario.scenario import FluidCondition, Scenario
from ecu_emulator.scenario.scenario_file import load_scenario

STREAM = "0b54b51f-6c0c-4b2c-8a6b-3f7a4c1f2d10"
START_NS = 1_767_225_600_123_456_000  # 2026-01-01T00:00:00.123456Z


def friction_estimate() -> FrictionEstimate:
    return FrictionEstimate(
        mu_c=0.1361,
        mu_s=0.1 + 0.02,
        std_mu_c=0.0012,
        std_mu_s=0.0016,
        correlation=0.4,
        random_std_mu_c=0.0007,
        random_std_mu_s=0.0011,
        slope_s_rad=0.0021,
        std_slope_s_rad=0.0003,
        probability_negative_slope=1e-9,
    )


def scale_free_friction() -> ScaleFreeFriction:
    return ScaleFreeFriction(mu_c=0.1388, mu_s=0.1224, std_mu_c=0.0009, std_mu_s=0.0013, correlation=0.3)


def friction_trend() -> FrictionTrend:
    return FrictionTrend(
        change_mu_c=-0.0021,
        change_mu_s=0.0004,
        std_change_mu_c=0.0006,
        std_change_mu_s=0.001,
        change_mu_c_ratio=-0.0152,
        change_mu_s_ratio=0.0033,
        std_change_mu_c_ratio=0.0043,
        std_change_mu_s_ratio=0.0083,
        baseline_end_bus_ns=START_NS - 900_000_000,
        baseline_shift_count=15,
        later_shift_count=4,
    )


def shift_estimate(number: int = 1, to_gear: int = 2) -> ShiftEstimate:
    start_ns = START_NS + (number - 1) * 4_000_000_000
    return ShiftEstimate(
        number=number,
        from_gear=to_gear - 1,
        to_gear=to_gear,
        clutch=clutch_of_gear(to_gear),
        start_ns=start_ns,
        end_ns=start_ns + 900_000_000,
        status=Status.VALID,
        reasons=(),
        friction=friction_estimate(),
        fit=EventFit(sample_count=31, window_s=0.31, chi_square_ratio=0.97, quality=0.9),
        conditions=EventConditions(
            sump_temperature_k=353.15,
            clutch_temperature_k=361.0,
            slip_energy_j=8400.0,
            duration_s=0.9,
            odometer_m=1234.0,
        ),
        data_quality=DataQuality(score=0.9 * 0.95, parts={QualityPart.FRAMES: 0.95, QualityPart.PROTECTION: 0.9}),
        scale_free=scale_free_friction(),
    )


def at(estimate: ShiftEstimate, **conditions: Any) -> ShiftEstimate:  # noqa: ANN401 - numbers of the conditions
    """Return an estimate of an event under other conditions."""
    return replace(estimate, conditions=replace(estimate.conditions, **conditions))


def shift_result(seq: int = 1, *, vehicle: str = "car1", stream: str = STREAM, to_gear: int = 2) -> ShiftResult:
    estimate = shift_estimate(seq, to_gear)
    return ShiftResult(
        vehicle=vehicle,
        stream=stream,
        seq=seq,
        estimate=estimate,
        verdict=ClutchVerdict(
            clutch=estimate.clutch,
            condition=Condition.GOOD,
            reason="mu-v slope negative with probability 0.000",
            level_ratio=0.99,
            friction=friction_estimate(),
            shift_count=seq,
            scale_free=scale_free_friction(),
            common_scale_std_ratio=0.03,
            shift_scatter=ShiftScatter(std_mu_c=0.0021, std_mu_s=0.0047, shift_count=18),
            trend=friction_trend(),
            clutch_ratio=ClutchRatio(mu_c_ratio=1.004, mu_s_ratio=0.991, std_mu_c_ratio=0.014, std_mu_s_ratio=0.017),
            advice=advice(estimate.clutch, None, 0.999),
        ),
        algorithm_version="algorithm-1",
        calibration_version="1+0123456789ab",
        produced_at="2026-01-01T00:00:05.000000Z",
    )


def rejected(result: ShiftResult) -> ShiftResult:
    """Return the result of a shift from which nothing was learnt."""
    estimate = replace(
        result.estimate,
        status=Status.REJECTED,
        friction=None,
        scale_free=None,
        conditions=EventConditions(duration_s=result.estimate.conditions.duration_s),
    )
    verdict = ClutchVerdict(
        clutch=result.verdict.clutch,
        condition=Condition.NO_VERDICT,
        reason=result.verdict.reason,
        level_ratio=None,
        friction=None,
        shift_count=0,
    )
    return replace(result, estimate=estimate, verdict=verdict)


def drive_scenario(name: str = "noise_only", *, fluid: str = "ideal", seed: int = 1, cycles: int = 1) -> Scenario:
    """Return a shipped scenario with another fluid, seed or length."""
    scenario = load_scenario(name)
    condition = FluidCondition(fluid)
    return replace(scenario, fluid=replace(scenario.fluid, condition=condition), seed=seed, cycles=cycles)


def with_latencies(count: int, latency_s: float) -> Posterior:
    """Return what is known after events that show pressures so much later than those of the type."""
    row, state = STATE_COUNT + Considered.PRESSURE_LATENCY, Posterior.fresh(nominal_calibration())
    for number in range(count):
        shown = Evidence.of_readings([row], [latency_s], [0.005**2])
        state = state.with_event(JudgedEvent(clutch=1 + number % 2, end_ns=number, evidence=shown))
    return state
