"""How people read numbers: how far a value may be off."""

from typing import Final

STDS: Final = 2.0  # on either side: about 95 of 100 truths lie within
PLUS_MINUS: Final = "± two standard deviations"
SHORT_PLUS_MINUS: Final = "± 2 std"  # heads of narrow columns


def plus_minus(value: float, std: float, form: str = "{:.4f}", *, scale: float = 1.0) -> str:
    """Return a value with two of its standard deviations, both times ``scale``."""
    return f"{form.format(scale * value)} ± {half_width(std, form, scale=scale)}"


def half_width(std: float, form: str = "{:.4f}", *, scale: float = 1.0) -> str:
    """Return two standard deviations, times ``scale``; what a form says of signs does not hold for them."""
    return form.replace("+", "").format(STDS * scale * std)
