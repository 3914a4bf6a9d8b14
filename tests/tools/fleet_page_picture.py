"""Makes the pictures of the pages in docs/fleet.md: a made-up fleet that ages at different rates, one vehicle of it.

python -m tests.tools.fleet_page_picture docs
"""

import argparse
import sys
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
from PIL import Image

from clutch_results.curves import CHANGE_LEVEL_RATIO, WATCH_LEVEL_RATIO
from clutch_results.event_kinds import EventKind, PackHeat, ShiftParts, ShiftQuality
from clutch_results.records import Condition, ShiftResult
from diag_service.diagnosis.condition.thresholds import Cause
from diag_service.diagnosis.condition.verdict import advice
from fleet_backend import queries
from fleet_backend.database import open_database
from fleet_backend.migrate import migrate
from fleet_backend.rows import Row
from fleet_backend.writer import Batch, Writer
from tests.support.browsing import chromium
from tests.support.builders import at, friction_estimate
from tests.support.fleet import row_of
from tests.support.fleet_page import served
from tests.support.histories import CALIBRATION, history
from tests.support.shiftings import scattered

START = datetime(2026, 3, 1, 7, tzinfo=UTC)
RESULTS = 240
SHOWN = "taxi-117"
FLEET = {
    "taxi-104": 0.235,
    SHOWN: 0.16,
    "taxi-121": 0.11,
    "van-03": 0.05,
    "bus-2": 0.075,
    "van-11": 0.13,
}  # loss of mu_C
DISTANCE_M = 2.6e5  # between two results
DAYS = 0.72
WIDTH, COLOURS = 1200, 160
PAGES = {
    "fleet-page.png": ("/", 1150),
    "page.png": (f"/vehicles/{SHOWN}", 980),
    "maintenance.png": ("/maintenance", 900),
}
_NEW = CALIBRATION.clutches[0].friction


def aged(result: ShiftResult, loss: float, number: int, rng: np.random.Generator) -> Row:
    """Return a result as it is after so much of a life."""
    estimate, clutch = result.estimate, result.estimate.clutch
    level = 1.0 - loss * (1.0 if clutch == 1 else 0.8) * result.seq / RESULTS
    running = replace(friction_estimate(), mu_c=_NEW.mu_c * level, mu_s=_NEW.mu_s, std_mu_c=0.0028, std_mu_s=0.003)
    own = replace(
        running,
        mu_c=running.mu_c * (1.0 + 0.012 * rng.standard_normal()),
        mu_s=running.mu_s * (1.0 + 0.02 * rng.standard_normal()),
        std_mu_c=0.0033,
        std_mu_s=0.0042,
        random_std_mu_c=0.0016,
        random_std_mu_s=0.0025,
    )
    worst = Condition.CHANGE_FLUID if level < CHANGE_LEVEL_RATIO else Condition.WATCH
    condition = Condition.GOOD if level >= WATCH_LEVEL_RATIO else worst
    cause = None if condition is Condition.GOOD else Cause.LEVEL_FALLING
    verdict = replace(
        result.verdict,
        condition=condition,
        friction=running,
        level_ratio=level,
        advice=advice(clutch, cause, 0.97),
    )
    end = START + timedelta(days=DAYS * result.seq + 0.1 * number)
    end_ns = int(end.timestamp() * 1e9)
    estimate = replace(
        at(
            estimate,
            odometer_m=3.1e7 + 7e6 * number + DISTANCE_M * result.seq,
            sump_temperature_k=353.0 + 12.0 * rng.random(),
        ),
        start_ns=end_ns - 2_000_000_000,
        end_ns=end_ns,
        friction=None if estimate.friction is None else own,
        kind=EventKind.POWER_ON_UPSHIFT,
        shift_quality=shifted(1.0 - level, clutch, rng),
    )
    produced_at = end.strftime("%Y-%m-%dT%H:%M:%S.%fZ")
    return row_of(replace(result, estimate=estimate, verdict=verdict, produced_at=produced_at))


def shifted(lost: float, clutch: int, rng: np.random.Generator) -> ShiftQuality:
    """Return how well a change went where so much of the friction is lost."""
    energy_j, peak_k = 4_500.0 * (1.0 + lost) * rng.uniform(0.7, 1.3), 371.0 + 30.0 * lost + 4.0 * rng.random()
    idle = PackHeat(slip_energy_j=0.0)
    hot = PackHeat(slip_energy_j=energy_j, peak_k=peak_k, life_ratio=1e-10 * energy_j)
    score = 88.0 - 110.0 * lost + 1.9 * rng.standard_normal()
    parts = ShiftParts(
        touch_error_pa=4_000.0, std_touch_error_pa=1_200.0, fill_error_s=0.01, std_fill_error_s=0.02,
        jerk_m_s3=14.0 + 60.0 * lost, torque_hole_m_s2=0.9 + 4.0 * lost, flare_rad_s=1.0, tie_up_nm=3.0,
        overtime_s=0.0, temperature_rise_k=energy_j / 1_500.0, lock_rate_rad_s2=80.0, acceleration_m_s2=1.4,
    )  # fmt: skip
    packs = (hot, idle) if clutch == 1 else (idle, hot)
    return ShiftQuality(score=score, reasons=("jerk_m_s3", "torque_hole_m_s2"), parts=parts, packs=packs)


def fill(database: str) -> None:
    """Make the fleet."""
    engine, rng = open_database(database), np.random.default_rng(5)
    migrate(engine)
    for number, (vehicle, loss) in enumerate(FLEET.items()):
        results = history(RESULTS, vehicle=vehicle, stream=f"stream-{number}")
        Writer(engine).store(Batch(shifts=[aged(one, loss, number, rng) for one in results]))
        queries.note_fill(engine, vehicle, "DCTF 75W", at=START, odometer_m=3.1e7 + 7e6 * number, note=None)
    untold = scattered(rng, [0, 30, 60, 90, 120], 30, growth=0.3, among=0.01)  # of a car without pressures
    Writer(engine).store(Batch(shifts=[row_of(replace(one, vehicle="sedan-7")) for one in untold]))
    engine.dispose()


def main() -> int:
    """Write the pictures and say how large they are."""
    parser = argparse.ArgumentParser(description="The pictures of the fleet's pages in the documents.")
    parser.add_argument("folder", type=Path)
    target = parser.parse_args().folder
    with TemporaryDirectory() as folder:
        database = f"sqlite:///{folder}/fleet.sqlite"
        fill(database)
        with served(database) as address, chromium() as browser:
            for name, (path, height) in PAGES.items():
                page = browser.new_page(viewport={"width": WIDTH, "height": height})
                page.goto(address + path)
                page.screenshot(path=target / name)
    for name in PAGES:
        picture = Image.open(target / name).convert("RGB").quantize(COLOURS, dither=Image.Dither.NONE)
        picture.save(target / name, optimize=True)
        print(f"{target / name}: {(target / name).stat().st_size / 1000:.0f} kB")
    return 0


if __name__ == "__main__":
    sys.exit(main())
