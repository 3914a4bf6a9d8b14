"""Numbers for people, with few digits and two standard deviations, and moments of clocks that were set."""

from datetime import UTC, datetime
from math import floor, isfinite, log10, pi
from typing import Final

STDS: Final = 2.0  # on either side: about 95 of 100 truths lie within
PLUS_MINUS: Final = "± two standard deviations"
SHORT_PLUS_MINUS: Final = "± 2 std"  # heads of narrow columns
PER_1000_RPM: Final = 1000.0 * pi / 30.0  # rad/s: people read a slope over speed [s/rad] times this
SLOPE_UNIT: Final = "per 1000 rpm"
DATED_NS: Final = 10**18  # since 1970: in 2001; earlier times have no date, the clock was not set
NOT_SET: Final = "clock not set"
_DIGITS: Final = 4
_MOST_DECIMALS: Final = 6


def plus_minus(value: float, std: float, form: str = "{:.4f}", *, scale: float = 1.0) -> str:
    """Return a value with two of its standard deviations, both times ``scale``."""
    return f"{form.format(scale * value)} ± {half_width(std, form, scale=scale)}"


def half_width(std: float, form: str = "{:.4f}", *, scale: float = 1.0) -> str:
    """Return two standard deviations, times ``scale``, in a form without its sign."""
    return form.replace("+", "").format(STDS * scale * std)


def is_dated(at: datetime) -> bool:
    """Return whether the clock that told an aware moment was set."""
    return at.timestamp() >= DATED_NS / 1e9


def moment_words(at: datetime, form: str = "%Y-%m-%d %H:%M") -> str:
    """Return an aware moment in UTC, or that the clock was not set."""
    return at.astimezone(UTC).strftime(form) if is_dated(at) else NOT_SET


def km_words(distance_m: float) -> str:
    """Return a distance [m] in kilometres with two digits that mean something."""
    return f"{round(float(f'{distance_m / 1000.0:.2g}')):,d}"


def digits(value: float) -> str:
    """Return a number with four significant digits at most, and no digit before the point lost: 0.1209, 12346."""
    if value == 0.0 or not isfinite(value):
        return f"{value:g}"
    decimals = min(max(_DIGITS - 1 - floor(log10(abs(value))), 0), _MOST_DECIMALS)
    text = f"{value:.{decimals}f}"
    text = text.rstrip("0").rstrip(".") if decimals else text
    return "0" if text == "-0" else text
