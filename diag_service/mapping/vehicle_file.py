"""The description of a vehicle: a calibration with the ratios of its gears, every value with where it is from.

It is what ``diag-service learn`` writes and a person completes; a calibration is one without ratios.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Final, NamedTuple

from clutch_model.calibration import (
    Calibration,
    ClutchCalibration,
    believed_calibration,
    calibration_table,
    calibration_toml,
    with_clutch,
)
from clutch_model.errors import CalibrationError
from diag_service.diagnosis.columns import GearRatios
from diag_service.mapping.profile import gear_ratios

if TYPE_CHECKING:
    from diag_service.mapping.learning import LearnedValue, LearnedVehicle

LEARNED: Final = "learned"  # the table of what the logs told: for people, nothing is computed from it
PA_PER_KPA: Final = 1e3
_LOG, _ASSUMED = "  # from the log", "  # assumed"
_OF_TOUCH: Final = ("spring_preload_n", "spring_rate_n_m")  # of a clutch: what its touch point makes of them


class Described(NamedTuple):
    """What a description says."""

    calibration: Calibration
    gears: GearRatios | None  # None: a signal tells the gear


def read_description(path: Path) -> Described:
    """Read a calibration, a file or a shipped one by name, or the description of a vehicle; raises CalibrationError."""
    table = calibration_table(path)
    gears = table.pop("gears", None)
    table.pop(LEARNED, None)
    try:
        ratios = gear_ratios(gears, CalibrationError)
        return Described(believed_calibration(table), ratios)
    except CalibrationError as exc:
        raise CalibrationError(f"{path}: {exc}") from exc


def described(learned: "LearnedVehicle", assumed: Calibration, name: str) -> Calibration:
    """Return a calibration with what was learned; all else is assumed as the type has it."""
    clutches, stds = assumed.clutches, [assumed.uncertainty.touch_pressure_pa]
    for clutch in (1, 2):
        if (touch := learned.touch_point(clutch)) is not None:
            clutches = with_clutch(clutches, clutch, _touching_at(clutches[clutch - 1], touch.value))
            stds.append(touch.std)
    uncertainty = replace(assumed.uncertainty, touch_pressure_pa=max(stds))
    return replace(assumed, name=name, clutches=clutches, uncertainty=uncertainty)


def _touching_at(clutch: ClutchCalibration, touch_pa: float) -> ClutchCalibration:
    """Return a clutch whose spring is as strong as a touch point says."""
    share = touch_pa / clutch.touch_pressure_pa
    piston = replace(
        clutch.piston,
        spring_preload_n=share * clutch.piston.spring_preload_n,
        spring_rate_n_m=share * clutch.piston.spring_rate_n_m,
    )
    return replace(clutch, piston=piston)


def description_toml(learned: "LearnedVehicle", assumed: Calibration, name: str, remarks: tuple[str, ...]) -> str:
    """Return the text of a description, with where each value is from behind it."""
    calibration = described(learned, assumed, name)
    lines = [f"# {remark}".rstrip() for remark in remarks]
    clutch = 0
    for line in calibration_toml(calibration).splitlines():
        clutch += line == "[[clutch]]"
        is_value = " = " in line and not line.startswith(("name", "version"))
        lines.append(f"{line}{_behind(line, learned.touch_point(clutch) if clutch else None) if is_value else ''}")
    ratios = learned.ratios
    if ratios is not None:
        values = ", ".join(f"{ratio:.5g}" for ratio in ratios.ratios)
        lines += ["", "[gears]", f'over = "{ratios.over.value}"', f"ratios = [{values}]{_LOG}"]
    return "\n".join([*lines, "", *learned_lines(learned)]) + "\n"


def _behind(line: str, touch: "LearnedValue | None") -> str:
    """Return where a value of a calibration is from: only springs follow a touch point, that of their own clutch."""
    if touch is None or not line.startswith(_OF_TOUCH):
        return _ASSUMED
    return f"  # {touch.origin}" if touch.is_assumed else f"{_LOG}: its touch point"


def learned_lines(learned: "LearnedVehicle") -> Iterator[str]:
    """Yield the tables of what the logs told, as TOML."""
    for number, gear in learned.gears.items():
        yield f'[{LEARNED}."gear {number}"]'
        yield f"ratio = {gear.ratio.ratio:.5g}"
        yield f"ratio_std = {gear.ratio.std:.2g}"
        yield f"sample_count = {gear.ratio.sample_count}"
        if gear.clutch is not None:
            yield f"clutch = {gear.clutch}"
    tables: tuple[tuple[str, Mapping[int, LearnedValue], float], ...] = (
        ("touch_pressure_kpa", learned.touch_pa, 1.0 / PA_PER_KPA),
        ("pressure_lag_ms", learned.lag_s, 1e3),
        ("gain_rad_s2_kpa", learned.gain_rad_s2_pa, PA_PER_KPA),
    )
    for clutch in sorted({number for _, by_clutch, _ in tables for number in by_clutch}):
        yield f'[{LEARNED}."clutch {clutch}"]'
        for name, values, scale in tables:
            if (value := values.get(clutch)) is not None:
                yield f"{name} = {scale * value.value:.4g}"
                yield f"{name}_std = {scale * value.std:.2g}"
                yield f'{name}_origin = "{value.origin}"'
    if learned.rates_hz:
        yield f"[{LEARNED}.rates_hz]"
        yield from (f"{signal.value} = {rate:.3g}" for signal, rate in learned.rates_hz.items())
