"""The picture of docs/model.md: a launch, a kickdown, a skip and a cold start, as the plant of the emulator has them.

python -m studies.driving_picture    # drives US06, WLTC, and UDDS from -10 degC, writes docs/driving.svg; a minute
"""

import argparse
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from studies.drawing import CLUTCH_COLOUR, INK, as_svg, drawing_style
from studies.drive_events import planned
from canlog.arrays import FloatArray
from clutch_model.units import bar_from_pa, k_from_degc, rpm_from_rad_s
from ecu_emulator.drive.build import WHOLE_STAY_S, build_vehicle, journey
from ecu_emulator.driving.indices import EventKind
from ecu_emulator.plant import Col
from ecu_emulator.scenario.drive_names import DriveName
from ecu_emulator.scenario.scenario import Ambient
from ecu_emulator.scenario.scenario_file import load_scenario

PATH: Final = Path(__file__).parents[1] / "docs" / "driving.svg"
STRETCH_S: Final = 60.0
AROUND_S: Final = 0.4
EVERY: Final = 10  # rows of a millisecond
LONGEST_S: Final = 8.0  # of an event in the picture


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """One event of a drive to be shown."""

    title: str
    trace: str
    oil_degc: float
    kind: EventKind
    place: int = 0  # among the events of this kind


SCENES: Final = (
    Scene(title="Launch", trace="us06", oil_degc=80.0, kind=EventKind.LAUNCH),
    Scene(title="Kickdown", trace="wltc", oil_degc=80.0, kind=EventKind.KICKDOWN),
    Scene(title="Power-on skip", trace="us06", oil_degc=80.0, kind=EventKind.POWER_ON_SKIP),
    Scene(title="Cold start, oil at -10 degC", trace="udds", oil_degc=-10.0, kind=EventKind.LAUNCH),
)
SPEEDS: Final[Mapping[str, tuple[Col, str]]] = {
    "engine": (Col.ENGINE_SPEED, INK),
    "input shaft 1": (Col.INPUT1_SPEED, CLUTCH_COLOUR[1]),
    "input shaft 2": (Col.INPUT2_SPEED, CLUTCH_COLOUR[2]),
}
TORQUES: Final[Mapping[str, tuple[Col, str]]] = {
    "engine": (Col.ENGINE_TORQUE, INK),
    "clutch 1": (Col.CLUTCH1_TORQUE, CLUTCH_COLOUR[1]),
    "clutch 2": (Col.CLUTCH2_TORQUE, CLUTCH_COLOUR[2]),
}
PRESSURES: Final[Mapping[str, tuple[Col, str]]] = {
    "clutch 1": (Col.PRESSURE1, CLUTCH_COLOUR[1]),
    "clutch 2": (Col.PRESSURE2, CLUTCH_COLOUR[2]),
}


def rows_of(trace: str, oil_degc: float) -> FloatArray:
    """Drive, and return the plant's record, every hundredth of a second."""
    oil_k = k_from_degc(oil_degc)
    ambient = Ambient(temperature_k=min(oil_k, 293.15), oil_temperature_k=oil_k, coolant_temperature_k=oil_k)
    scenario = replace(load_scenario("noise_only"), drive=DriveName.CITY, ambient=ambient)
    car = journey(scenario, build_vehicle(scenario), WHOLE_STAY_S, iter([planned(trace)]))
    parts = []
    while len(rows := car.advance(STRETCH_S)):
        parts.append(rows[::EVERY].copy())
    return np.concatenate(parts)


def cut(rows: FloatArray, scene: Scene) -> FloatArray:
    """Return the rows of an event and a moment around it."""
    numbers = rows[rows[:, Col.EVENT_KIND] == scene.kind, Col.EVENT_NUMBER]
    number = np.unique(numbers)[scene.place]
    t_s = rows[rows[:, Col.EVENT_NUMBER] == number, Col.T_S]
    first_s, last_s = t_s[0] - AROUND_S, min(t_s[-1], t_s[0] + LONGEST_S) + AROUND_S
    shown: FloatArray = rows[(rows[:, Col.T_S] >= first_s) & (rows[:, Col.T_S] <= last_s)]
    return shown


def draw(scenes: Sequence[tuple[Scene, FloatArray]]) -> str:
    """Return the picture as SVG: speeds, torques and pressures of each scene, one below the other."""
    with drawing_style():
        figure = Figure(figsize=(14.0, 7.5), layout="constrained")
        axes = figure.subplots(3, len(scenes), sharex="col")
        for column, (scene, rows) in enumerate(scenes):
            _draw(axes[0, column], rows, SPEEDS, rpm_from_rad_s(1.0))
            _draw(axes[1, column], rows, TORQUES, 1.0)
            _draw(axes[2, column], rows, PRESSURES, bar_from_pa(1.0))
            axes[0, column].set_title(scene.title)
            axes[2, column].set_xlabel("time, s")
        for row, label in enumerate(("speed, rpm", "torque, Nm", "pressure, bar")):
            axes[row, 0].set_ylabel(label)
            axes[row, 0].legend(loc="best")
        return as_svg(figure)


def _draw(axes: Axes, rows: FloatArray, lines: Mapping[str, tuple[Col, str]], scale: float) -> None:
    t_s = rows[:, Col.T_S] - rows[0, Col.T_S]
    for label, (column, colour) in lines.items():
        axes.plot(t_s, scale * rows[:, column], color=colour, lw=1.4, label=label)


def main(argv: Sequence[str] | None = None) -> int:
    """Make the picture."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--output", type=Path, default=PATH)
    arguments = parser.parse_args(argv)
    drives = {(one.trace, one.oil_degc): rows_of(one.trace, one.oil_degc) for one in SCENES}
    scenes = [(one, cut(drives[one.trace, one.oil_degc], one)) for one in SCENES]
    arguments.output.write_text(draw(scenes), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
