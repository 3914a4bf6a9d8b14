"""Gear changes, launches, run-ups, stretches of slip with the signals around them: what is cut out of the columns.

SI units, radians, kelvin and pascal throughout. Times are bus times in integer nanoseconds since the epoch.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

from canlog.e2e.e2e_state import E2eState
from clutch_results.event_kinds import EndReason, EventKind
from diag_service.diagnosis.columns import Columns


@dataclass(frozen=True, slots=True, kw_only=True)
class Event:
    """Something that happened on a drive, with its signals cut a little wider than itself."""

    kind: EventKind = EventKind.SHIFT
    number: int  # 1, 2, ... within the stream, run-ups by themselves
    from_gear: int  # 0: neutral
    to_gear: int  # without a change of gears the same again
    start_ns: int
    end_ns: int
    end_reason: EndReason
    columns: Columns
    bad_frame_count: int  # rejected or missing frames of mapped messages inside the cut
    has_whole_seconds: bool = False  # of times, with many frames in each: when in a second they came nobody knows
    e2e: Mapping[str, E2eState] = field(default_factory=dict)  # message -> INVALID if it ever was, else its last state
    came_late: bool = False  # some frames came in bursts: when they were sent is not known exactly

    @property
    def are_clutches_closed(self) -> bool:
        """Whether it is a run-up with both clutches closed all along."""
        return self.kind is EventKind.RUN_UP_CLOSED
