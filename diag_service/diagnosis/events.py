"""Shifts and free engine run-ups with the signals around them: what shift finding cuts out of the columns.

SI units, radians, kelvin and pascal throughout. Times are bus times in integer nanoseconds since the epoch.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from canlog.e2e.e2e_state import E2eState
from diag_service.diagnosis.columns import Columns


class EndReason(StrEnum):
    """How a shift or a run-up ended."""

    COMPLETE = "complete"
    INTERRUPTED = "interrupted"  # the stream began or ended amid it, or bus time jumped
    TOO_LONG = "too_long"
    ABANDONED = "abandoned"  # the target gear changed or went back before it was reached; in a run-up one was chosen


class EventKind(StrEnum):
    """What happened."""

    SHIFT = "shift"  # from the first sample with target != current gear to the first at which they agree again
    RUN_UP_OPEN = "run_up_open"  # in neutral the engine ran from low speed to high and back, both clutches empty
    RUN_UP_CLOSED = "run_up_closed"  # the same, both clutches closed


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """Something that happened on a drive, with its signals cut a little wider than itself."""

    kind: EventKind = EventKind.SHIFT
    number: int  # 1, 2, ... within the stream, shifts and run-ups by themselves
    from_gear: int  # 0: neutral
    to_gear: int
    start_ns: int
    end_ns: int
    end_reason: EndReason
    columns: Columns
    bad_frame_count: int  # rejected or missing frames of mapped messages inside the cut
    e2e: Mapping[str, E2eState] = field(default_factory=dict)  # message -> INVALID if it ever was, else its last state

    @property
    def are_clutches_closed(self) -> bool:
        """Whether it is a run-up with both clutches closed all along."""
        return self.kind is EventKind.RUN_UP_CLOSED
