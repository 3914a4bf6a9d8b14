"""Whether two senders share the identifiers of one vehicle, as two emulators on one bus do: counters tell."""

import logging
from dataclasses import dataclass
from typing import Final

from diag_service.diagnosis.summary import FrameCounts

BY_COUNTER: Final = ("repeated", "wrong_sequence")  # two senders in step repeat each other's counters
ENOUGH_FRAMES: Final = 500  # judged by their counters; about a second of a bus
SUSPICIOUS_SHARE: Final = 0.2  # two senders in turn come to about a half, one on a bad bus to a few percent
_LOG = logging.getLogger(__name__)


@dataclass(slots=True)
class SenderWatch:
    """Looks at the counts of a run again and again and says what they tell, once for as long as it lasts."""

    _decoded: int = 0  # until the last judgement
    _rejected: int = 0
    _is_said: bool = False

    def warn(self, frames: FrameCounts) -> None:
        """Warn of what there is to be said."""
        if (text := self.look(frames)) is not None:
            _LOG.warning("%s", text)

    def look(self, frames: FrameCounts) -> str | None:
        """Return what is to be said about the frames since the last judgement, None if nothing is."""
        rejected = sum(frames.rejected.get(reason, 0) for reason in BY_COUNTER)
        wrong, right = rejected - self._rejected, frames.decoded - self._decoded
        if wrong + right < ENOUGH_FRAMES:
            return None
        self._decoded, self._rejected = frames.decoded, rejected
        share = wrong / (wrong + right)
        was_said, self._is_said = self._is_said, share >= SUSPICIOUS_SHARE
        if was_said or not self._is_said:
            return None
        return (
            f"{share:.0%} of {wrong + right} frames have a counter that does not follow the last: two senders use the "
            "same identifiers, such as two emulators on one bus, or frames come twice"
        )
