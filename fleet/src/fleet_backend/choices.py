"""What a user can choose, and what holds if not; imports nothing that a plain installation lacks."""

from dataclasses import dataclass
from enum import StrEnum
from typing import Final

BROKER_VARIABLE: Final = "CLUTCHDIAG_BROKER"  # these keep passwords out of the process list
GROUP_VARIABLE: Final = "CLUTCHDIAG_GROUP"
DATABASE_VARIABLE: Final = "CLUTCHDIAG_DATABASE"


class TrendAxis(StrEnum):
    """Against what a trend is drawn."""

    SHIFT = "shift"
    ODOMETER = "odometer"
    DATE = "date"


@dataclass(frozen=True, slots=True, kw_only=True)
class Quotas:
    """How much is taken of a vehicle in a day (UTC); 0: any number."""

    results: int = 100_000
    quarantined: int = 1_000
    size_bytes: int = 500_000_000  # of all its messages


@dataclass(frozen=True, slots=True, kw_only=True)
class Pace:
    """How messages are gathered: a transaction costs a disk's turn, whatever it holds."""

    batch_size: int = 500  # results of a transaction, messages read at once
    patience_s: float = 0.02  # how long the first message of a batch waits for others
    takes_bundles: bool = True  # whether vehicles hear that they may send several results in one message

    @property
    def max_unsettled(self) -> int:
        """Messages that the broker may have sent us and we have not settled: one batch at work, one on its way."""
        return 2 * self.batch_size
