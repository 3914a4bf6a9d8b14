"""The errors that simulated lives are given, beside those of the real estimator over simulated drives of ageing fluid.

A vehicle is drawn as ``studies.self_calibration`` draws it, and driven again and again while its fluid goes from new
to a margin of none: plant, sensors, frames, decoding, events, estimate, the state carried from drive to drive. Each
result of a single shift is held against the truth of its drive.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from rich.table import Table

from studies.accuracy import to_batch
from studies.drawn_vehicle import draw
from studies.prognosis.lives import ERRORS
from studies.prognosis.truth import CASE_2, GONE, REFERENCE
from canlog.arrays import FloatArray, Int64Array
from clutch_model.calibration import nominal_calibration
from clutch_model.units import k_from_degc
from dbc.contract import load_contract
from diag_service.diagnosis.condition.condition import ConditionMemory
from diag_service.diagnosis.friction import Posterior
from diag_service.diagnosis.records import ShiftEstimate, Status
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from diag_service.service.stages import Diagnosis, Stages
from ecu_emulator.drive.recording import frames_of
from ecu_emulator.scenario.scenario import Ambient, FluidCondition, Routine, Truth

DRIVES: Final = 24  # of one vehicle, from new fluid to a margin of none
DAY_S: Final = 86_400.0
OIL_DEGC: Final = (55.0, 95.0)  # of each drive's beginning
FIRST_SEED: Final = 61_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One single shift: relative errors of (mu_C, mu_S), and what was stated of them."""

    vehicle: int
    clutch: int
    drive: int
    damage: float  # 1: no margin is left
    oil_k: float
    error: tuple[float, float]
    random_std: tuple[float, float]
    random_correlation: float
    total_std: tuple[float, float]


def rows_of(seed: int) -> list[Row]:
    """Drive one vehicle through the life of its fluid."""
    vehicle = draw(seed, has_mismatch=seed % 2 == 1)
    rng = np.random.default_rng([seed, 59])
    calibration = nominal_calibration()
    state, memory = Posterior.fresh(calibration), ConditionMemory.fresh()
    rows: list[Row] = []
    for drive in range(DRIVES):
        damage = GONE * drive / (DRIVES - 1)
        oil_k = k_from_degc(float(rng.uniform(*OIL_DEGC)))
        true = (REFERENCE.mu_c * (1.0 - CASE_2 * damage), REFERENCE.mu_s * (1.0 + CASE_2 * damage))
        scenario = vehicle.scenario(drive, Routine())
        friction: dict[str, object] = {
            f"clutch{clutch}.friction.{name}": value
            for clutch in (1, 2)
            for name, value in zip(("mu_c", "mu_s"), true, strict=True)
        }
        frames, _ = frames_of(
            replace(
                scenario,
                fluid=replace(scenario.fluid, condition=FluidCondition.IDEAL),
                ambient=Ambient(temperature_k=min(oil_k, 293.15), oil_temperature_k=oil_k, coolant_temperature_k=oil_k),
                truth=Truth(calibration={**scenario.truth.calibration, **friction}),
            )
        )
        stages = Stages(Decoder(load_contract(), load_profile()), calibration, state, memory)
        found: list[Diagnosis] = stages.feed(to_batch(replace(frames, t_s=frames.t_s + drive * DAY_S)))
        found += [stages.conclude(event) for event in stages.flush()]
        state, memory = found[-1].state, found[-1].memory
        rows += [row for one in found if (row := _row(seed, drive, one.estimate, np.array(true))) is not None]
    return rows


def _row(vehicle: int, drive: int, estimate: ShiftEstimate, true: FloatArray) -> Row | None:
    known, free = estimate.friction, estimate.scale_free
    if estimate.status is not Status.VALID or known is None or free is None:
        return None
    error = np.array([known.mu_c, known.mu_s]) / true - 1.0
    return Row(
        vehicle=vehicle,
        clutch=estimate.clutch,
        drive=drive,
        damage=drive / (DRIVES - 1),
        oil_k=estimate.sump_temperature_k or 0.0,
        error=(float(error[0]), float(error[1])),
        random_std=(known.random_std_mu_c / known.mu_c, known.random_std_mu_s / known.mu_s),
        random_correlation=free.correlation,
        total_std=(known.std_mu_c / known.mu_c, known.std_mu_s / known.mu_s),
    )


def errors_table(rows: Sequence[Row]) -> Table:
    """Return each part of the errors beside what simulated lives are given; a vehicle's first drive is left out."""
    error = np.array([row.error for row in rows])
    stated = np.array([row.random_std for row in rows])
    damage = np.array([row.damage for row in rows])
    clutch = _groups([(row.vehicle, row.clutch) for row in rows])
    drive = _groups([(row.vehicle, row.clutch, row.drive) for row in rows])
    means, counts = _means(error, drive), np.bincount(drive)
    widened: FloatArray = np.sqrt(counts / (counts - 1.0), dtype=np.float64)
    single = (error - means[drive]) * widened[drive, None]
    single_std = _rms(single)
    line = [_line(means[own], _means(damage[:, None], drive)[own, 0]) for own in _drives_of(clutch, drive)]
    about = np.concatenate([one[1] for one in line])
    shared = np.sqrt(np.maximum(_rms(about) ** 2 - single_std**2 / counts.mean(), 0.0))
    ends = np.array([[one[0][0], one[0].sum(axis=0)] for one in line])  # new, gone: (clutches, 2, 2)
    split = ends[..., 1] - ends[..., 0]
    used = np.sqrt(np.mean(np.square(ERRORS.worse))) * np.array(ERRORS.stated)
    table = Table("part of the error, %", "of mu_C", "of mu_S", "lives have", title=_title(rows, clutch))
    table.add_row("single shift, true", *_percents(single_std), " ".join(_percents(used)))
    table.add_row("single shift, stated", *_percents(np.median(stated, axis=0)), " ".join(_percents(ERRORS.stated)))
    correlation = float(np.mean(single[:, 0] * single[:, 1]) / np.prod(single_std))
    table.add_row("correlation of the two", f"{correlation:+.2f}", "", f"{ERRORS.correlation:+.2f}")
    table.add_row("what a drive shares", *_percents(shared), " ".join(_percents(ERRORS.drive)))
    table.add_row("what a life shares, scatter", *_percents(ends.mean(axis=1).std(axis=0)), f"{100 * ERRORS.scale:.2f}")
    for row, name, has in ((0, "new", ERRORS.split_new), (1, "gone", ERRORS.split_gone)):
        table.add_row(f"mu_S against mu_C, margin {name}, scatter", "", *_percents([split[:, row].std(), has]))
        table.add_row(f"mu_S against mu_C, margin {name}, mean", "", f"{100 * split[:, row].mean():+.2f}", "0")
    return table


def _title(rows: Sequence[Row], clutch: Int64Array) -> str:
    return f"{len(rows)} single shifts of {clutch.max() + 1} clutches over the life of a fluid"


def _groups(keys: Sequence[tuple[int, ...]]) -> Int64Array:
    return np.asarray(np.unique(np.array(keys), axis=0, return_inverse=True)[1], np.int64).reshape(-1)


def _drives_of(clutch: Int64Array, drive: Int64Array) -> list[Int64Array]:
    return [np.unique(drive[clutch == one])[1:] for one in range(int(clutch.max()) + 1)]


def _means(value: FloatArray, group: Int64Array) -> FloatArray:
    return np.array([np.bincount(group, column) / np.bincount(group) for column in value.T]).T


def _line(value: FloatArray, damage: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a straight line through the means of drives, value when new and change until gone, and what is left."""
    design = np.column_stack([np.ones_like(damage), damage])
    found = np.asarray(np.linalg.lstsq(design, value, rcond=None)[0], np.float64)
    return found, np.asarray((value - design @ found) * np.sqrt(len(value) / (len(value) - 2.0)), np.float64)


def _rms(value: FloatArray) -> FloatArray:
    return np.asarray(np.sqrt(np.mean(value**2, axis=0)))


def _percents(values: Sequence[float] | FloatArray) -> list[str]:
    return [f"{100.0 * float(value):.2f}" for value in values]
