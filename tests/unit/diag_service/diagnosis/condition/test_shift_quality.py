"""What shifts say of their own quality, and how they scatter."""

from dataclasses import replace

import numpy as np
import pytest

from canlog.arrays import FloatArray, Series
from clutch_model.calibration import nominal_calibration
from clutch_model.pack import film_law
from clutch_results.event_kinds import EndReason, EventKind, PackHeat, ShiftQuality
from clutch_results.loads import PARTS
from clutch_results.records import FrictionEstimate, ShiftEstimate
from clutch_results.shift_course import ShiftCourse, courses, load_line, loads
from diag_service.diagnosis.columns import GearRatios, Signal
from diag_service.diagnosis.condition.shift_quality import ShiftScorer
from diag_service.diagnosis.condition.verdict import RunningScatter
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.friction import Posterior
from diag_service.diagnosis.friction.drives import PackTemperatures
from tests.support.builders import at, friction_estimate, shift_result

CALIBRATION = nominal_calibration()
KNOWN = Posterior.fresh(CALIBRATION).fusion.knowledge
TOUCH_PA = CALIBRATION.clutches[1].touch_pressure_pa
STEP_NS, START_NS = 10_000_000, 1_000_000_000
T_S = np.arange(-0.5, 1.3, 0.01)
END_S, HANDED_S, LOCKED_S = 1.2, 0.5, 0.9
OLD_RAD_S, NEW_RAD_S = 300.0, 240.0
BAR_PA = 1e5
ENGINE = np.interp(T_S, [HANDED_S, LOCKED_S - 0.2, LOCKED_S], [OLD_RAD_S, NEW_RAD_S + 8.0, NEW_RAD_S])
FILM = film_law(CALIBRATION.clutches[1])
NM_PER_PA = 0.140 * FILM.contact_factor_m3 * FILM.piston_area_m2 / FILM.lining_area_m2
ASKED_NM = np.interp(T_S, [0.2, HANDED_S], [0.0, 100.0])


def event(**changed: FloatArray | float | None) -> Event:
    """Return a change from gear 1 to 2; signals by the names of their members, None takes one away."""
    on_pa = TOUCH_PA + ASKED_NM / NM_PER_PA
    filling = (T_S >= 0.0) & (T_S < 0.15)
    told: dict[str, FloatArray | float | None] = {
        "ENGINE_SPEED": ENGINE,
        "INPUT1_SPEED": OLD_RAD_S,
        "INPUT2_SPEED": NEW_RAD_S,
        "OUTPUT_SPEED": 100.0 + 10.0 * T_S,
        "VEHICLE_SPEED": 8.0 + 0.8 * T_S,
        "ENGINE_TORQUE": 100.0,
        "CLUTCH1_PRESSURE": np.where(T_S < HANDED_S, 2.0 * BAR_PA, 0.0),
        "CLUTCH2_PRESSURE": np.where(T_S < 0.0, 0.0, on_pa),
        "CLUTCH2_PRESSURE_COMMAND": np.where(filling, 7.0 * BAR_PA, np.where(T_S < 0.0, 0.0, on_pa)),
        "CLUTCH2_TORQUE_COMMAND": ASKED_NM,
    } | changed
    series = {
        Signal[name]: Series(
            t_ns=START_NS + np.rint(T_S * 1e9).astype(np.int64),
            sequence=np.arange(len(T_S)),
            value=np.broadcast_to(np.asarray(value, np.float64), T_S.shape).copy(),
        )
        for name, value in told.items()
        if value is not None
    }
    return Event(
        kind=EventKind.POWER_ON_UPSHIFT,
        number=1,
        from_gear=1,
        to_gear=2,
        start_ns=START_NS,
        end_ns=START_NS + round(END_S * 1e9),
        end_reason=EndReason.COMPLETE,
        columns=series,
        bad_frame_count=0,
    )


def quality(given: Event, gears: GearRatios | None = None, *, has_scale: bool = True) -> ShiftQuality:
    found = ShiftScorer(CALIBRATION, gears).score(given, KNOWN if has_scale else None)
    assert found is not None
    return found


def test_a_faultless_change_has_all_parts_and_costs_nothing() -> None:
    found = quality(event())
    assert found.score == pytest.approx(100.0)
    assert found.reasons == ()
    assert all(getattr(found.parts, part.name) is not None for part in PARTS)
    assert found.parts.lock_rate_rad_s2 == pytest.approx(40.0, abs=2.0)
    assert found.parts.overtime_s == 0.0
    assert found.parts.touch_error_pa == pytest.approx(0.0, abs=100.0)


def test_a_pack_is_as_hot_as_its_slip_makes_it_while_the_oil_cools() -> None:
    thermal = CALIBRATION.clutches[1].thermal
    rate_1_s = thermal.convection_w_k / thermal.heat_capacity_j_k
    power_w = np.where((T_S >= 0.0) & (T_S < END_S) & (ENGINE > NEW_RAD_S + 2.0), ASKED_NM * (ENGINE - NEW_RAD_S), 0.0)
    left = np.exp(-rate_1_s * np.arange(len(T_S)) * 0.01)
    rise_k = float(np.convolve(power_w, left)[: len(T_S)].max()) * 0.01 / thermal.heat_capacity_j_k
    cold = quality(event(SUMP_TEMPERATURE=360.0))
    assert cold.packs[1].peak_k == pytest.approx(360.0 + rise_k, abs=0.03 * rise_k)
    assert cold.packs[0].peak_k == pytest.approx(360.0, abs=0.01)
    assert cold.packs[1].life_ratio == pytest.approx(  # ten faces of 60 cm2
        (cold.packs[1].slip_energy_j or 0.0) / 8.62e9, rel=0.002
    )
    warm = PackTemperatures(clutch_k=(400.0, 380.0), at_ns=START_NS - 1_000_000_000)
    hot = ShiftScorer(CALIBRATION, None).score(event(SUMP_TEMPERATURE=360.0), KNOWN, warm)
    assert hot is not None
    own = CALIBRATION.clutches[0].thermal
    left_ratio = np.exp(-own.convection_w_k / own.heat_capacity_j_k)
    assert hot.packs[0].peak_k == pytest.approx(360.0 + 40.0 * left_ratio, abs=0.1)
    assert 3.0 < (hot.packs[1].peak_k or 0.0) - (cold.packs[1].peak_k or 0.0) < 20.0
    assert quality(event()).packs[1].peak_k is None  # nothing is known of the oil


def test_an_engine_that_runs_away_is_a_flare() -> None:
    flare = 20.0 * np.exp(-(((T_S - 0.4) / 0.08) ** 2))
    found = quality(event(ENGINE_SPEED=ENGINE + flare))
    assert found.parts.flare_rad_s == pytest.approx(20.0, abs=1.0)
    assert found.reasons[0] == "flare_rad_s"
    assert found.score is not None
    assert found.score < 90.0


def test_both_clutches_carry_against_each_other() -> None:
    both_pa = np.where((T_S > 0.3) & (T_S < 0.5), TOUCH_PA + 150.0 / NM_PER_PA, TOUCH_PA)
    found = quality(event(CLUTCH2_PRESSURE=both_pa, CLUTCH1_PRESSURE=4.0 * BAR_PA))
    assert found.parts.tie_up_nm == pytest.approx(50.0, abs=2.0)
    assert "tie_up_nm" in found.reasons


def test_a_hole_in_the_acceleration_is_as_deep_as_it_is_and_jerks() -> None:
    slope_m_s2 = np.where((T_S > 0.4) & (T_S < 0.8), -2.2, 0.8)
    car_m_s = 8.0 + np.cumsum(slope_m_s2) * 0.01
    found = quality(event(OUTPUT_SPEED=None, VEHICLE_SPEED=car_m_s))
    assert found.parts.torque_hole_m_s2 == pytest.approx(3.0, abs=0.1)
    assert found.parts.jerk_m_s3 == pytest.approx(23.4, rel=0.03)  # 78 % of a step in 0.1 s, through a window of 0.17 s
    assert set(found.reasons) >= {"torque_hole_m_s2", "jerk_m_s3"}


def test_what_is_no_gear_change_has_no_score_and_what_was_broken_off_nothing() -> None:
    launch = replace(event(), kind=EventKind.LAUNCH, from_gear=2)
    found = quality(launch)
    assert (found.score, found.reasons, found.parts.flare_rad_s, found.parts.tie_up_nm) == (None, (), None, None)
    assert found.packs[1].slip_energy_j == quality(event()).packs[1].slip_energy_j
    broken = replace(event(), end_reason=EndReason.INTERRUPTED)
    assert ShiftScorer(CALIBRATION, None).score(broken, KNOWN) is None


STILL = PackHeat(slip_energy_j=0.0)
UPSHIFT = ShiftQuality(score=80.0, reasons=("jerk_m_s3",), packs=(STILL, PackHeat(slip_energy_j=5_000.0)))


def result(
    seq: int, quality: ShiftQuality | None, *, oil_k: float = 350.0, kind: str = "power_on_upshift"
) -> ShiftEstimate:
    given = at(shift_result(seq).estimate, sump_temperature_k=oil_k)
    return replace(given, shift_quality=quality, kind=EventKind(kind))


def test_a_course_has_both_ends_and_the_oil() -> None:
    some = [result(seq, replace(UPSHIFT, score=90.0), oil_k=300.0) for seq in range(20)]
    some += [result(20 + seq, replace(UPSHIFT, score=60.0)) for seq in range(20)]
    some.append(result(41, None))
    (found,) = courses(some)
    assert found == ShiftCourse(
        kind=EventKind.POWER_ON_UPSHIFT, from_gear=1, to_gear=2, count=40, first=90.0, last=60.0,
        by_oil=(90.0, 60.0, None), reason="jerk_m_s3", untold=tuple(part.name for part in PARTS),
    )  # fmt: skip
    assert courses([result(1, None)]) == []
    some += [result(50 + seq, replace(UPSHIFT, score=40.0, reasons=("flare_rad_s",))) for seq in range(20)]
    assert courses(some)[0].reason == "flare_rad_s"  # why they go badly now, however many did for another reason


def test_the_load_of_a_clutch_is_what_it_slipped() -> None:
    hot = replace(UPSHIFT, packs=(STILL, PackHeat(slip_energy_j=5_000.0, peak_k=390.0, life_ratio=2e-6)))
    launch = ShiftQuality(score=None, packs=(STILL, PackHeat(slip_energy_j=40_000.0, peak_k=410.0, life_ratio=16e-6)))
    unseen = ShiftQuality(score=None)  # without pressures
    some = [result(1, hot), result(2, hot), result(3, launch, kind="launch"), result(4, unseen, kind="launch")]
    (found,) = loads([*some, result(5, unseen), result(6, None)])
    assert (found.clutch, found.counts, found.energy_j, found.launch_count) == (2, (0, 0, 0, 2, 0, 1), 50_000.0, 2)
    assert found.peak_k == 410.0
    assert found.life_ratio == pytest.approx(20e-6)
    assert load_line(found) == (
        "Clutch 2 turned 0.05 MJ into heat in 3 events, launches: 2, at most 137 °C; 0.0020 % of its lining's life, as "
        "an index."
    )


RUNNING = replace(friction_estimate(), random_std_mu_c=0.0, random_std_mu_s=0.0)
STD = np.array([0.002, 0.005])


def shift(distances: np.ndarray) -> FrictionEstimate:
    return replace(RUNNING, mu_c=RUNNING.mu_c + distances[0], mu_s=RUNNING.mu_s + distances[1], random_std_mu_c=0.001)


def followed(distances: np.ndarray, running: FrictionEstimate = RUNNING) -> RunningScatter:
    scatter = RunningScatter.begun(replace(shift(distances[0]), random_std_mu_s=0.003))
    for one in distances:
        scatter = scatter.with_shift(replace(shift(one), random_std_mu_s=0.003), running)
    return scatter


def test_it_is_the_deviation_of_the_shifts() -> None:
    rng = np.random.default_rng(1)
    found = []
    for _ in range(60):
        reported = followed(rng.normal(size=(60, 2)) * STD).reported
        assert reported is not None
        found.append((reported.std_mu_c, reported.std_mu_s))
    assert np.mean(found, axis=0) == pytest.approx(STD, rel=0.1)
    assert np.all(np.std(found, axis=0) < 0.2 * STD)
