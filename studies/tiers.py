"""What a car without pressures tells of its gear changes, against the truth: error, stated deviation, coverage.

Vehicles are drawn as ``studies.self_calibration`` draws them, film, oil and lining unlike the belief as well, and
driven along the first minutes of a trace. Their frames are read as four other cars send them, without counters and
checksums: with torques at the rates of common buses, and with speeds alone. The truth is the plant's, by the
definitions of docs/model.md, indices of a shift: true speeds in place of readings, a row a millisecond; a gear change
begins and ends with the true gears. Torque capacity is what the on-coming clutch carries at slip over what is asked of
it, heat what it turns into heat while it is pressed, the ratio that of the gears, jerk that of the car's body.

A bar is missed if fewer than 92 % of the errors are inside two stated deviations, if the median stated deviation is
beyond 1.5 times the RMS error, or if more than 99 % are inside while it is beyond 1.25 times: an error that lies
anywhere between two samples is never beyond 1.73 of its deviations, however right these are.

    python -m studies.tiers                      # 60 vehicles
    python -m studies.tiers --trace wltc --seconds 600
"""

import sys
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, Final

import numpy as np
from rich.console import Console
from rich.table import Table

from canlog.arrays import BoolArray, FloatArray
from canlog.frames import FrameBatch
from clutch_model.calibration import clutch_of_gear, nominal_calibration
from clutch_results.event_kinds import GEAR_CHANGES, EndReason
from clutch_results.records import ShiftEstimate
from dbc.contract import DBC_PATH
from diag_service.diagnosis.condition.index_signals import LEAST_JUDDER_S, band_square
from diag_service.diagnosis.condition.shift_indices import INDEX_GRID_S, MIN_TORQUE_NM, MIN_WINDOW_S, RELEASED_RATIO
from diag_service.diagnosis.shifts.shifts import SLIP_RAD_S
from diag_service.mapping.interpretation import Interpretation, interpret
from diag_service.service.stages import Stages
from ecu_emulator.bus.frames import merge
from ecu_emulator.drive.recording import Drive
from ecu_emulator.driving.journey import Trip
from ecu_emulator.plant.parameters import nominal_parameters
from ecu_emulator.plant.state import Col
from ecu_emulator.scenario import DriveName
from ecu_emulator.scenario.scenario import WorkshopRoutine
from ecu_emulator.truth import PRESSED_NM
from studies.builders import EPOCH_US, STRETCH_S, TRACES, in_oil, planned, to_batch
from studies.drawn_vehicle import draw
from studies.run import over_drives, parsed, root_mean_square, study_parser

FIRST_SEED: Final = 97_000  # seeds 1 to 8 were looked at while definitions and deviations were chosen
OIL_DEGC: Final = 80.0
LEAST_INSIDE, MOST_INSIDE, MOST_STATED, MOST_STATED_ALL = 0.92, 0.99, 1.5, 1.25
MEASURES: Final = {  # of the table: the unit, and how many of it are one of SI
    "shift_time_s": ("ms", 1e3),
    "slip_duration_s": ("ms", 1e3),
    "peak_slip_rad_s": ("rad/s", 1.0),
    "torque_capacity_ratio": ("%", 1e2),
    "slip_energy_j": ("J", 1.0),
    "judder_rad_s": ("rad/s", 1.0),
    "jerk_m_s3": ("m/s3", 1.0),
    "ratio_before": ("1/1000", 1e3),
    "ratio_after": ("1/1000", 1e3),
}
NEAR_S: Final = 1.5  # of the true end of a gear change
MARGIN_ROWS: Final = 400  # of the plant around it

_UNKNOWN: Final = ("SG_ Crc8", "SG_ AliveCounter", "E2EDataId", "CM_ SG_")  # on other buses
_SPEEDS: Final = {
    "engine_speed_rad_s": ("ECM_TorqueSpeed", "EngineSpeed"),
    "current_gear": ("TCU_Shift", "CurrentGear"),
    "target_gear": ("TCU_Shift", "TargetGear"),
    "vehicle_speed_m_s": ("BRK_Vehicle", "VehicleSpeed"),
}
_ALONE: Final = {**_SPEEDS, "output_speed_rad_s": ("TCU_Output", "OutputSpeed")}
_TORQUES: Final = {
    **_SPEEDS,
    "engine_torque_nm": ("ECM_TorqueSpeed", "EngineTorque"),
    "pedal_ratio": ("ECM_TorqueSpeed", "Pedal"),
    "input1_speed_rad_s": ("TCU_InputSpeeds", "InputShaft1Speed"),
    "input2_speed_rad_s": ("TCU_InputSpeeds", "InputShaft2Speed"),
    "clutch1_torque_command_nm": ("TCU_Output", "Clutch1TorqueCmd"),
    "clutch2_torque_command_nm": ("TCU_Output", "Clutch2TorqueCmd"),
}
_IDS: Final = {"ECM_TorqueSpeed": 160, "TCU_InputSpeeds": 176, "TCU_Output": 178, "TCU_Shift": 179, "BRK_Vehicle": 193}


@dataclass(frozen=True, slots=True, kw_only=True)
class Broadcast:
    """What a car puts on its bus."""

    name: str
    signals: Mapping[str, tuple[str, str]]
    every: Mapping[str, int]  # message -> only each n-th of the emulator's frames


BROADCASTS: Final = (
    Broadcast(name="torques, 10 ms", signals=_TORQUES, every={}),
    Broadcast(
        name="torques, shafts 20 ms, gears 100 ms", signals=_TORQUES, every={"TCU_InputSpeeds": 2, "TCU_Shift": 10}
    ),
    Broadcast(name="speeds alone, 10 ms", signals=_ALONE, every={}),
    Broadcast(
        name="speeds alone, 50 ms",
        signals=_ALONE,
        every={"ECM_TorqueSpeed": 5, "TCU_Output": 5, "TCU_Shift": 5, "BRK_Vehicle": 2},
    ),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class TierCase:
    """One drive of one vehicle."""

    seed: int
    trace: str
    duration_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Compared:
    """One index of one event: what was stated, and what is true."""

    broadcast: str
    measure: str
    value: float
    std: float
    true: float


class KeptRows(Trip):
    """A trip that keeps its rows."""

    def __init__(self, kept: list[FloatArray], *course: Any) -> None:  # noqa: ANN401 - as of a trip
        super().__init__(*course)
        self._kept = kept

    def advance(self, duration_s: float) -> FloatArray:
        rows = super().advance(duration_s)
        self._kept.append(rows.copy())
        return rows


def compared(case: TierCase) -> list[Compared]:
    """Drive, read the frames as each of the cars sends them, and return all indices beside the truth."""
    vehicle = draw(case.seed, has_mismatch=True)
    scenario = replace(vehicle.scenario(0, WorkshopRoutine()), drive=DriveName.CITY)
    kept, batches = list[FloatArray](), list[FrameBatch]()
    drive = Drive(in_oil(scenario, OIL_DEGC), planned=iter([planned(case.trace)]), make_trip=partial(KeptRows, kept))
    for stretch in drive.stretches(STRETCH_S):
        batches.append(to_batch(merge([stretch.frames])))
        if len(batches) * STRETCH_S >= case.duration_s:
            break
    rows = np.concatenate(kept)
    changes = true_changes(rows)
    found = []
    for broadcast in BROADCASTS:
        with tempfile.TemporaryDirectory() as folder:
            stages = Stages(meaning_of(broadcast, Path(folder)).decoder(), nominal_calibration())
        diagnoses = [one for batch in batches for one in stages.feed(thinned(batch, broadcast.every))]
        for diagnosis in diagnoses:
            found += list(_compared(broadcast.name, diagnosis.estimate, rows, changes))
    return found


def meaning_of(broadcast: Broadcast, folder: Path) -> Interpretation:
    """Return the database and the profile of a car, which are ours without what it does not send."""
    lines = DBC_PATH.read_text(encoding="utf-8").splitlines()
    lines = [line for line in lines if not any(word in line for word in _UNKNOWN)]
    for message, every in broadcast.every.items():
        cycle = f'BA_ "GenMsgCycleTime" BO_ {_IDS[message]} '
        lines = [
            f"{cycle}{int(line.removeprefix(cycle).rstrip(';')) * every};" if line.startswith(cycle) else line
            for line in lines
        ]
    dbc, profile = folder / "car.dbc", folder / "car.toml"
    dbc.write_text("\n".join(lines), encoding="utf-8")
    sources = [
        f'{name} = {{ message = "{message}", signal = "{signal}" }}'
        for name, (message, signal) in broadcast.signals.items()
    ]
    profile.write_text("\n".join(['name = "car"', "[signals]", *sources]), encoding="utf-8")
    return interpret(dbc, profile)


def thinned(batch: FrameBatch, every: Mapping[str, int]) -> FrameBatch:
    """Return frames of which some messages come more seldom."""
    is_kept = np.ones(len(batch), np.bool_)
    for message, count in every.items():
        rows = np.flatnonzero(batch.can_id == _IDS[message])
        is_kept[rows] = False
        is_kept[rows[::count]] = True
    return batch[is_kept]


Change = tuple[int, int, int, int]
"""First row, row behind the last, old and new gear of a gear change."""


def true_changes(rows: FloatArray) -> list[Change]:
    """Return the gear changes of the plant that reached their gear."""
    current, target = rows[:, Col.CURRENT_GEAR], rows[:, Col.TARGET_GEAR]
    is_changing = (target != current) & (current > 0.0) & (target > 0.0)
    edges = np.flatnonzero(np.diff(is_changing, prepend=False, append=False)).reshape(-1, 2)
    return [
        (first, stop, int(current[first]), int(current[stop]))
        for first, stop in edges.tolist()
        if stop < len(rows) and current[stop] == target[stop - 1]
    ]


def _compared(
    broadcast: str, estimate: ShiftEstimate, rows: FloatArray, changes: Sequence[Change]
) -> Iterator[Compared]:
    """Yield the indices of a completed gear change that the plant has too."""
    is_change = estimate.kind in GEAR_CHANGES and estimate.end_reason is EndReason.COMPLETE
    if not is_change or estimate.indices is None:
        return
    end_row = (estimate.end_ns // 1000 - EPOCH_US) / 1e3
    near = [
        change
        for change in changes
        if change[2:] == (estimate.from_gear, estimate.to_gear) and abs(change[1] - end_row) < 1e3 * NEAR_S
    ]
    true = true_indices(rows, min(near, key=lambda change: abs(change[1] - end_row))) if near else {}
    for measure, true_value in true.items():
        value = getattr(estimate.indices, measure)
        if value is not None:
            std = getattr(estimate.indices, f"std_{measure}")
            yield Compared(broadcast=broadcast, measure=measure, value=value, std=std, true=true_value)


def true_indices(rows: FloatArray, change: Change) -> dict[str, float]:
    """Return the indices of a gear change by the plant's own speeds and torques; docs/model.md (I1) to (I8)."""
    first, stop, from_gear, to_gear = change
    on, off = clutch_of_gear(to_gear) - 1, clutch_of_gear(from_gear) - 1
    ratios = nominal_parameters().gearbox.input_output_ratios
    during = rows[first:stop]
    slip = during[:, Col.HUB_SPEED] - during[:, Col.INPUT1_SPEED + on]
    is_slipping = np.abs(slip) > SLIP_RAD_S
    torque = during[:, Col.CLUTCH1_TORQUE + on]
    is_pressed = np.abs(torque - during[:, Col.VISCOUS1_TORQUE + on]) > PRESSED_NM
    true = {
        "shift_time_s": 1e-3 * (stop - first),
        "slip_duration_s": 1e-3 * float(np.count_nonzero(is_slipping)),
        "peak_slip_rad_s": _true_peak(rows[max(first - 25, 0) : stop + 25], on),
        "slip_energy_j": 1e-3 * float(np.abs(torque * slip)[is_slipping & is_pressed].sum()),
        "jerk_m_s3": _true_jerk(
            rows[max(first - MARGIN_ROWS, 0) : stop + MARGIN_ROWS], min(first, MARGIN_ROWS), stop - first
        ),
        "ratio_before": ratios[from_gear - 1],
        "ratio_after": ratios[to_gear - 1],
    }
    capacity = _true_capacity(during, slip, is_slipping, (on, off))
    judder = _true_judder(slip, is_slipping)
    return true | ({} if capacity is None else capacity) | ({} if judder is None else judder)


def _true_peak(rows: FloatArray, on: int) -> float:
    size = np.abs(rows[:, Col.HUB_SPEED] - rows[:, Col.INPUT1_SPEED + on])
    return float(np.convolve(size, np.full(51, 1.0 / 51.0), "valid").max())


def _true_capacity(
    during: FloatArray, slip: FloatArray, is_slipping: BoolArray, clutches: tuple[int, int]
) -> dict[str, float] | None:
    on, off = clutches
    asked, other = during[:, Col.TORQUE1_COMMAND + on], during[:, Col.TORQUE1_COMMAND + off]
    rows = is_slipping & (asked > MIN_TORQUE_NM) & (np.abs(other) < RELEASED_RATIO * asked)
    if np.count_nonzero(rows) * 1e-3 < MIN_WINDOW_S:
        return None
    carried = during[rows, Col.CLUTCH1_TORQUE + on] * np.sign(slip[rows])
    return {"torque_capacity_ratio": float(asked[rows] @ carried / (asked[rows] @ asked[rows]))}


def _true_judder(slip: FloatArray, is_slipping: BoolArray) -> dict[str, float] | None:
    rows = np.flatnonzero(is_slipping)
    if not len(rows) or (rows[-1] - rows[0]) * 1e-3 < LEAST_JUDDER_S:
        return None
    thinned_slip = slip[rows[0] : rows[-1] + 1 : round(1e3 * INDEX_GRID_S)]
    return {"judder_rad_s": float(np.sqrt(band_square(thinned_slip, INDEX_GRID_S)[0]))}


def _true_jerk(rows: FloatArray, first: int, count: int) -> float:
    """Return the largest change within 0.1 s of the body's acceleration, lines through 0.16 s, over that time."""
    along = np.arange(-80.0, 81.0)
    slopes = np.full(len(rows), np.nan)
    slopes[80:-80] = 1e3 * np.correlate(rows[:, Col.VEHICLE_SPEED], along, "valid") / (along @ along)
    change = slopes[first : first + count] - slopes[max(first - 100, 0) : first - 100 + count]
    return float(np.nanmax(np.abs(change))) / 0.1


def table_of(name: str, found: Sequence[Compared]) -> tuple[Table, bool]:
    """Return the table of one car, and whether it meets all bars."""
    table = Table(
        "index",
        "unit",
        "events",
        "median",
        "RMS error",
        "stated, median",
        "over error",
        "inside 2 std",
        "bar",
        title=name,
    )
    are_met = True
    for measure, (unit, scale) in MEASURES.items():
        some = [one for one in found if one.measure == measure]
        if not some:
            table.add_row(measure, unit, "0", *["-"] * 6)
            continue
        errors, stds = np.array([(one.value - one.true, one.std) for one in some]).T
        rms, stated = root_mean_square(errors), float(np.median(stds))
        inside = float(np.mean(np.abs(errors) < 2.0 * stds))
        is_met = inside >= LEAST_INSIDE and stated <= MOST_STATED * rms
        is_met &= inside <= MOST_INSIDE or stated <= MOST_STATED_ALL * rms
        are_met &= is_met
        median = scale * float(np.median([one.true for one in some]))
        table.add_row(
            measure, unit, str(len(some)), f"{median:.4g}", f"{scale * rms:.3g}", f"{scale * stated:.3g}",
            f"{stated / rms:.2f}", f"{inside:.1%}", "met" if is_met else "MISSED",
        )  # fmt: skip
    return table, are_met


def main() -> int:
    """Drive all vehicles and print a table for each kind of car; return 1 if a bar is missed."""
    parser = study_parser(__doc__, seed=FIRST_SEED)
    parser.add_argument("--vehicles", type=int, default=60)
    parser.add_argument("--trace", default="udds", choices=TRACES)
    parser.add_argument("--seconds", type=float, default=180.0, help="of the trace (%(default)s)")
    options = parsed(parser, vehicles=3)
    cases = [
        TierCase(seed=seed, trace=options.trace, duration_s=options.seconds)
        for seed in range(options.seed, options.seed + options.vehicles)
    ]
    found = over_drives(compared, cases, options.workers, options.kept)
    console, are_met = Console(markup=False, width=130), True
    for broadcast in BROADCASTS:
        table, is_met = table_of(broadcast.name, [one for one in found if one.broadcast == broadcast.name])
        console.print(table)
        are_met &= is_met
    return 0 if are_met else 1


if __name__ == "__main__":
    sys.exit(main())
