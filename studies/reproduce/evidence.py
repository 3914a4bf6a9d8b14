"""Why the noisy tables of the paper cannot be reached: what passes the gates of mu_S, and what holds the result."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from canlog.arrays import FloatArray
from diag_service.diagnosis.friction.paper.method import FrictionData, fit, static_gate
from studies.reproduce.drives import BoolArray, PaperDrive, noisy
from studies.reproduce.study import CALIBRATION, CLUTCHES, Setup, analysed, error_percent, true_value

PRIOR_FACTORS = (0.8, 0.9, 1.0, 1.1, 1.2)
PASS_COUNT = 5


@dataclass(frozen=True, slots=True, kw_only=True)
class StaticEvidence:
    """What lies behind mu_S of one clutch in one drive; means over the draws of the noise."""

    case: str
    clutch: int
    passed_count: float  # samples that pass every gate
    locked_share: float  # of them truly locked
    slow_share: float  # of them truly slipping as slowly as the gate wants
    ungated_mean_percent: float  # mean mu_i before the 20 % gate
    ungated_std_percent: float  # scatter of mu_i before the 20 % gate
    error_by_prior_percent: tuple[float, ...]  # error of mu_S with the gate around PRIOR_FACTORS times the truth
    pull: float  # d(mu_S)/d(prior): 0 the data decide, 1 the prior does
    error_by_pass_percent: tuple[float, ...]  # error when each estimate becomes the next pass's prior


def static_evidence(drive: PaperDrive, setup: Setup, seeds: range) -> list[StaticEvidence]:
    """Return the evidence on both clutches of a drive."""
    runs: dict[int, list[StaticEvidence]] = {clutch: [] for clutch in CLUTCHES}
    for seed in seeds:
        analysis = analysed(noisy(drive.signals, seed), setup)
        for clutch in CLUTCHES:
            runs[clutch].append(_one_run(drive, setup, clutch, analysis.clutches[clutch - 1].data))
    return [_averaged(parts) for parts in runs.values()]


def _one_run(drive: PaperDrive, setup: Setup, clutch: int, data: FrictionData) -> StaticEvidence:
    curve = CALIBRATION.clutches[clutch - 1].friction
    gates, true = setup.gates, true_value(drive, clutch, "mu_s")
    passed = static_gate(data, gates, curve.lock_band_rad_s, curve.mu_s)
    ungated = static_gate(data, replace(gates, prior_tolerance_ratio=None), curve.lock_band_rad_s, curve.mu_s)
    locked = drive.is_locked(clutch)
    excess_rad_s = np.abs(drive.slip_rad_s(clutch)) - curve.lock_band_rad_s
    slow = ~locked & (excess_rad_s > 0.0) & (excess_rad_s <= gates.stick_tolerance_rad_s)

    def estimate(prior: float) -> float:
        found = fit(data, gates, curve, prior).mu_s
        return prior if found is None else found

    by_prior = [estimate(factor * true) for factor in PRIOR_FACTORS]
    by_pass = [curve.mu_s]
    for _ in range(PASS_COUNT):
        by_pass.append(estimate(by_pass[-1]))
    return StaticEvidence(
        case=drive.case,
        clutch=clutch,
        passed_count=float(np.count_nonzero(passed)),
        locked_share=_share(locked, passed),
        slow_share=_share(slow, passed),
        ungated_mean_percent=100.0 * _mean(data.mu[ungated]) / true,
        ungated_std_percent=100.0 * float(np.std(data.mu[ungated])) / true,
        error_by_prior_percent=tuple(error_percent(one, true) for one in by_prior),
        pull=float(np.polyfit(np.array(PRIOR_FACTORS) * true, by_prior, 1)[0]),
        error_by_pass_percent=tuple(error_percent(one, true) for one in by_pass[1:]),
    )


def _averaged(parts: Sequence[StaticEvidence]) -> StaticEvidence:
    def mean(name: str) -> float:
        return float(np.mean([getattr(part, name) for part in parts]))

    def means(name: str) -> tuple[float, ...]:
        return tuple(np.mean([getattr(part, name) for part in parts], axis=0).tolist())

    return StaticEvidence(
        case=parts[0].case,
        clutch=parts[0].clutch,
        passed_count=mean("passed_count"),
        locked_share=mean("locked_share"),
        slow_share=mean("slow_share"),
        ungated_mean_percent=mean("ungated_mean_percent"),
        ungated_std_percent=mean("ungated_std_percent"),
        error_by_prior_percent=means("error_by_prior_percent"),
        pull=mean("pull"),
        error_by_pass_percent=means("error_by_pass_percent"),
    )


def _share(condition: BoolArray, among: BoolArray) -> float:
    count = np.count_nonzero(among)
    return float(np.count_nonzero(condition & among) / count) if count else 0.0


def _mean(values: FloatArray) -> float:
    return float(np.mean(values)) if len(values) else 0.0
