"""Steps of any length on the grid of whole milliseconds in which a car is driven."""

from fractions import Fraction

MS_PER_S = 1000


class StepGrid:
    """Hands out whole milliseconds: each step ends at the one nearest to where all steps until then end.

    A sum of fractions has no rounding errors: an hour of sixtieths of a second is an hour.
    """

    def __init__(self) -> None:
        self._owed_ms = Fraction()  # -0.5..0.5, what the steps until now have asked for beyond what they were given

    def whole_ms(self, duration_s: float) -> int:
        """Return how many milliseconds a step of this length [s], finite and above 0, is given."""
        self._owed_ms += MS_PER_S * Fraction(duration_s)
        given_ms = round(self._owed_ms)
        self._owed_ms -= given_ms
        return given_ms
