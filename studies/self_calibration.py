"""Self-calibration over many vehicles: what driving tells, what neutral revs add, what a frozen calibration holds.

Each vehicle is drawn: torque gain 3 %, offset 5 Nm, engine inertia 3 %, piston areas 1 %, pressure zeros and touch
points 0.05 bar, inertia of the input shafts 0.5 % (standard deviations); torque 0..40 ms, pressure 0..20 ms and all
speeds 0..10 ms late (uniform). Its first drive, workshop routine and three cycles, calibrates it three times: from the
cycles alone, with four revs, with the whole routine. Two more drives of three cycles are then estimated with the
calibration of the whole routine, frozen, and compared.

*Scale-free* is what a result calls so: friction times gain and piston area, without the common scale that driving
cannot tell.

    python -m studies.self_calibration --vehicles 102
    python -m studies.self_calibration --mismatch      # film, viscosity, w_S, K_c and touch point unlike the belief
    python -m studies.self_calibration --trace wltc --oil-degc -10 --other-laws     # from one drive on the road
"""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import Calibration, nominal_calibration
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.friction.evidence import FRICTION_COUNT
from diag_service.diagnosis.friction.posterior import friction as friction_of
from diag_service.diagnosis.friction.posterior import scale_free
from diag_service.diagnosis.friction.self_calibration import SelfCalibration, self_calibrate
from diag_service.diagnosis.shifts.run_ups import RunUpFinder
from diag_service.diagnosis.shifts.shifts import ShiftFinder
from ecu_emulator.bus.frames import EncodedFrames, merge
from ecu_emulator.drive.recording import Drive, frames_of
from ecu_emulator.scenario.scenario import Scenario, WorkshopRoutine
from studies.builders import STRETCH_S, TRACES, diagnose, new_decoder, planned, to_batch
from studies.drawn_vehicle import CYCLES, Vehicle, draw
from studies.drive_accuracy import Case, scenario_of
from studies.run import over_drives, parsed, root_mean_square, study_parser

FIRST_SEED = 27_000  # seeds below were looked at while priors and gates were chosen
REV_COUNT = 20
FEW_REVS = 4
LABELS = ("mu_C 1", "mu_S 1", "mu_C 2", "mu_S 2")


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationRow:
    """What one calibration of one vehicle found; errors in percent unless their name says otherwise."""

    kind: str
    problem: str = ""
    absolute: tuple[float, ...] = ()
    absolute_std: tuple[float, ...] = ()
    scale_free: tuple[float, ...] = ()  # of mu times gain of the torque reading and piston area
    scale_free_std: tuple[float, ...] = ()
    gain: float = 0.0
    inertia_over_gain: float = 0.0  # the product of inertia and gain of the reading: driving shows it
    torque_latency_ms: float = 0.0
    pressure_latency_ms: float = 0.0
    offset_nm: float = 0.0
    trend: tuple[float, ...] = ()  # of the same coefficient between two drives


def study(vehicle: Vehicle) -> list[CalibrationRow]:
    """Drive one vehicle three times and return its rows, calibrated from what is believed of its type."""
    routine = WorkshopRoutine(open_revs=REV_COUNT, closed_revs=REV_COUNT)
    frames, truth = frames_of(vehicle.scenario(0, routine))
    shifts, run_ups = events_of(frames)
    opened = [run_up for run_up in run_ups if not run_up.are_clutches_closed]
    true = np.array([value for m in range(2) for value in (truth.drive.mu_c[m], truth.drive.mu_s[m])])
    rows = []
    found: SelfCalibration | str = ""
    for kind, used in (("cycles alone", []), (f"+ {FEW_REVS} revs", opened[:FEW_REVS]), ("workshop", run_ups)):
        found = self_calibrate(shifts, used, nominal_calibration(), "study")
        rows.append(
            CalibrationRow(kind=kind, problem=found) if isinstance(found, str) else judged(kind, vehicle, found, true)
        )
    if not isinstance(found, str):
        drives = [driven_friction(vehicle.scenario(drive, WorkshopRoutine()), found.calibration) for drive in (1, 2)]
        rows.append(CalibrationRow(kind="trend", trend=tuple((100.0 * (drives[1] - drives[0]) / true).tolist())))
    return rows


def road_study(case: Case) -> list[CalibrationRow]:
    """Drive one vehicle along a trace and return what its events calibrate; a road has no revs in neutral."""
    scenario, vehicle = scenario_of(case)
    drive, decoder, finder, shifts = (
        Drive(scenario, planned=iter([planned(case.trace)])),
        new_decoder(),
        ShiftFinder(),
        [],
    )
    for columns in decoder.whole(to_batch(merge([stretch.frames])) for stretch in drive.stretches(STRETCH_S)):
        shifts += finder.feed(columns)
    found = self_calibrate(shifts + finder.flush(), [], nominal_calibration(), "study")
    kind = f"{case.trace} from {case.oil_degc:g} degC"
    if isinstance(found, str):
        return [CalibrationRow(kind=kind, problem=found)]
    true = np.array([value for m in range(2) for value in (drive.truth.mu_c[m], drive.truth.mu_s[m])])
    return [judged(kind, vehicle, found, true)]


def events_of(frames: EncodedFrames) -> tuple[list[Event], list[Event]]:
    """Return the shifts and revs that the service sees in a drive."""
    decoder, shift_finder, run_up_finder = new_decoder(), ShiftFinder(), RunUpFinder(nominal_calibration())
    shifts, run_ups = [], []
    for columns in decoder.whole([to_batch(frames)]):
        shifts += shift_finder.feed(columns)
        run_ups += run_up_finder.feed(columns)
    return shifts + shift_finder.flush(), run_ups + run_up_finder.flush()


def driven_friction(scenario: Scenario, calibration: Calibration) -> FloatArray:
    """Return mu_C and mu_S of both clutches as a drive leaves them, estimated from nothing but the calibration."""
    state = diagnose(scenario, calibration)[0][-1].belief.posterior
    return np.array(
        [value for clutch in (1, 2) for one in [friction_of(state, clutch)] for value in (one.mu_c, one.mu_s)]
    )


def judged(kind: str, vehicle: Vehicle, found: SelfCalibration, true: FloatArray) -> CalibrationRow:
    """Return what a calibration found against the truth."""
    friction = [friction_of(found.state, clutch) for clutch in (1, 2)]
    mu = np.array([value for one in friction for value in (one.mu_c, one.mu_s)])
    std = np.array([value for one in friction for value in (one.std_mu_c, one.std_mu_s)])
    scaled = found.mean[:FRICTION_COUNT]
    by_area = np.repeat(1.0 + np.array(vehicle.area_ratios), 2)
    nominal, clutches = nominal_calibration().clutches, found.calibration.clutches
    found_by_area = np.repeat(
        [
            one.geometry.piston_area_m2 / type_.geometry.piston_area_m2
            for one, type_ in zip(clutches, nominal, strict=True)
        ],
        2,
    )
    free = [scale_free(found.state, clutch) for clutch in (1, 2)]
    scaled_std = np.array([value for one in free for value in (one.std_mu_c, one.std_mu_s)])
    bias, side = found.calibration.bias, found.calibration.input_side
    nominal_kg_m2 = nominal_calibration().input_side.engine_inertia_kg_m2
    product = bias.torque_gain * side.engine_inertia_kg_m2 / nominal_kg_m2
    errors = mu / true - 1.0
    return CalibrationRow(
        kind=kind,
        absolute=_percent(errors),
        absolute_std=_percent(std / mu),
        scale_free=_percent(scaled * found_by_area / (true * vehicle.torque_gain * by_area) - 1.0),
        scale_free_std=_percent(scaled_std / scaled),
        gain=100.0 * (bias.torque_gain / vehicle.torque_gain - 1.0),
        inertia_over_gain=100.0 * (product / (vehicle.torque_gain * (1.0 + vehicle.inertia_ratio)) - 1.0),
        torque_latency_ms=1e3 * (bias.torque_latency_s - vehicle.torque_latency_s + vehicle.speed_latency_s),
        pressure_latency_ms=1e3 * (bias.pressure_latency_s - vehicle.pressure_latency_s + vehicle.speed_latency_s),
        offset_nm=bias.torque_offset_nm - vehicle.torque_offset_nm,
    )


def _percent(values: FloatArray) -> tuple[float, ...]:
    return tuple((100.0 * values).tolist())


def report(rows: Sequence[CalibrationRow]) -> Iterator[str]:
    """Yield the lines of the tables."""
    for kind in dict.fromkeys(row.kind for row in rows):
        chosen = [row for row in rows if row.kind == kind]
        failed = [row.problem for row in chosen if row.problem]
        chosen = [row for row in chosen if not row.problem]
        yield ""
        yield f"{kind}: {len(chosen)} vehicles" + (
            f", {len(failed)} refused: {'; '.join(set(failed))}" if failed else ""
        )
        if kind == "trend":
            trend = np.array([row.trend for row in chosen])
            yield _errors("between drives", trend)
            yield (f"  RMS mu_C {root_mean_square(trend[:, ::2]):.2f} %  mu_S {root_mean_square(trend[:, 1::2]):.2f} %")
            continue
        absolute = np.array([row.absolute for row in chosen])
        scale_free = np.array([row.scale_free for row in chosen])
        yield f"  {'RMS error, %':16}" + "".join(f"{label:>9}" for label in (*LABELS, "all"))
        yield _errors("scale-free", scale_free)
        yield _errors("absolute", absolute)
        for name, errors, std in (
            ("scale-free", scale_free, np.array([row.scale_free_std for row in chosen])),
            ("absolute", absolute, np.array([row.absolute_std for row in chosen])),
        ):
            inside = np.abs(errors) <= 2.0 * std
            yield (
                f"  {name}: stated std {root_mean_square(std):.2f} %, {100.0 * inside.mean():.1f} % "
                f"of {inside.size} within 2 std"
            )
        for name, values, unit in (
            ("torque gain", [row.gain for row in chosen], "%"),
            ("inertia over gain", [row.inertia_over_gain for row in chosen], "%"),
            ("torque latency", [row.torque_latency_ms for row in chosen], "ms"),
            ("pressure latency", [row.pressure_latency_ms for row in chosen], "ms"),
            ("torque offset", [row.offset_nm for row in chosen], "Nm"),
        ):
            yield f"  {name}: RMS {root_mean_square(np.array(values)):.2f} {unit}, bias {np.mean(values):+.2f} {unit}"


def _errors(name: str, errors: FloatArray) -> str:
    figures = [root_mean_square(column) for column in errors.T] + [root_mean_square(errors)]
    return f"  {name:16}" + "".join(f"{figure:9.2f}" for figure in figures)


def main() -> int:
    """Run the study and print its tables."""
    parser = study_parser(__doc__, seed=FIRST_SEED)
    parser.add_argument("--vehicles", type=int, default=102)
    parser.add_argument(
        "--mismatch", action="store_true", help="vehicles whose films and linings are unlike the belief"
    )
    parser.add_argument("--trace", choices=TRACES, help="from one drive on the road")
    parser.add_argument("--oil-degc", type=float, default=80.0, help="with --trace")
    parser.add_argument(
        "--other-laws", action="store_true", help="with --trace: of cold oil, as drive_accuracy has them"
    )
    arguments = parsed(parser, vehicles=4)
    seeds = range(arguments.seed, arguments.seed + arguments.vehicles)
    if arguments.trace is None:
        vehicles = [draw(seed, has_mismatch=arguments.mismatch) for seed in seeds]
        rows = over_drives(study, vehicles, arguments.workers, arguments.kept)
    else:
        case = partial(
            Case, trace=arguments.trace, oil_degc=arguments.oil_degc, has_mismatch=arguments.mismatch,
            loss_ratio=0.0, has_other_laws=arguments.other_laws,
        )  # fmt: skip
        cases = [case(seed=seed) for seed in seeds]
        rows = over_drives(road_study, cases, arguments.workers, arguments.kept)
    print(
        f"self-calibration, {arguments.trace or f'{CYCLES} cycles'}, seeds {seeds[0]}..{seeds[-1]}"
        + (", film, viscosity, w_S, K_c and touch point unlike the belief" if arguments.mismatch else "")
    )
    print("\n".join(report(rows)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
