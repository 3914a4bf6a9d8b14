"""How long frames may gather before they are looked at: every wake-up costs many times what a frame costs."""

from dataclasses import dataclass
from typing import Final

RELAXED_S: Final = 0.05  # 225 frames of a full bus of 500 kbit/s, which any receive buffer holds
URGENT_S: Final = 0.01


@dataclass(slots=True)
class Pace:
    """What a source and its consumer agree on; the consumer is in a hurry while somebody waits for a result."""

    is_urgent: bool = False

    @property
    def gather_s(self) -> float:
        """For how long frames may gather now [s]."""
        return URGENT_S if self.is_urgent else RELAXED_S
