"""The bars of speed: all that this project promises about it, in one place. Benchmarks hold their figures to them."""

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True, kw_only=True)
class Bar:
    """A limit on what a benchmark measures."""

    most: float | None = None
    least: float | None = None
    unit: str = ""

    def judged(self, figure: float) -> str:
        """Return what is asked of a figure, and whether it is met."""
        is_met = figure <= self.most if self.most is not None else figure >= (self.least or 0.0)
        asked = f"<= {self.most:g}" if self.most is not None else f">= {self.least:g}"
        return f"bar {asked}{self.unit}: {'met' if is_met else 'MISSED'}"


HOUR: Final = Bar(most=5.0, unit=" s")  # an hour of bus, from its file to results: studies.hour
EVENT: Final = Bar(most=10.0, unit=" ms")  # of a live event, once its frames are there: studies.estimator
FILTERPY: Final = Bar(least=1.0)  # the paper's filters over the same samples against a live event, in the same run
LOGS: Final = Bar(least=20.0)  # python-can with cantools against us, for candump, BLF and ASC: studies.readers
MF4: Final = Bar(least=1.0)  # asammdf against us
PLANT: Final = Bar(least=50.0)  # real time against the emulated plant: studies.plant
