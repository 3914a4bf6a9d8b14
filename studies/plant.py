"""The plant on its nominal cycle: error of the step, speed.

python -m studies.plant
"""

import time

import numpy as np
from rich.console import Console
from rich.table import Table

from clutch_model.calibration import nominal_calibration
from ecu_emulator.plant.course import DriveSettings
from ecu_emulator.plant.parameters import nominal_parameters
from ecu_emulator.plant.powertrain import Powertrain
from ecu_emulator.plant.state import Col
from studies import bars
from studies.run import parsed, study_parser

CALIBRATION = nominal_calibration()
PARAMETERS = nominal_parameters()
COMPARED_S = 10.0
CYCLE_LIMIT_S = 80.0
SPEED_RUNS = 5
STEPS_S = (2.5e-4, 2.0e-4, 1.0e-4)


def train(dt_s: float) -> Powertrain:
    return Powertrain(CALIBRATION, PARAMETERS, DriveSettings(dt_s=dt_s))


def step_halving(console: Console) -> None:
    table = Table("step [s]", "dw_H [rad/s]", "dT_F [N m]", title=f"Halving the step, {COMPARED_S:g} s")
    for dt_s in STEPS_S:
        change = np.abs(train(dt_s).advance(COMPARED_S) - train(dt_s / 2.0).advance(COMPARED_S))
        torque_nm = change[:, [Col.CLUTCH1_TORQUE, Col.CLUTCH2_TORQUE]].max()
        table.add_row(f"{dt_s:g} -> {dt_s / 2:g}", f"{change[:, Col.HUB_SPEED].max():.1e}", f"{torque_nm:.1e}")
    console.print(table)


def speed(console: Console) -> None:
    for dt_s in STEPS_S:
        times_s, simulated_s = [], 0.0
        for _ in range(SPEED_RUNS):
            plant = train(dt_s)
            start_s = time.process_time()
            simulated_s = len(plant.advance(CYCLE_LIMIT_S)) * 1e-3
            times_s.append(time.process_time() - start_s)
        mark = " (default)" if dt_s == DriveSettings().dt_s else ""
        ratio = simulated_s / min(times_s)
        console.print(
            f"plant speed at {dt_s:g} s{mark}: {ratio:.0f} x real time on one core   {bars.PLANT.judged(ratio)}"
        )


def main() -> None:
    parsed(study_parser(__doc__, is_parallel=False))
    console = Console(markup=False)  # units stand in brackets
    train(DriveSettings().dt_s).advance(0.01)  # compiles, or loads the cache
    step_halving(console)
    speed(console)


if __name__ == "__main__":
    main()
