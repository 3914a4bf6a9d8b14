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
    ABANDONED = "abandoned"  # the target gear changed or went back before it was reached


@dataclass(frozen=True, slots=True, kw_only=True)
class ShiftEvent:
    """One gear change with its signals, cut a little wider than the shift itself."""

    number: int  # 1, 2, ... within the stream
    from_gear: int
    to_gear: int
    start_ns: int  # first sample with target != current
    end_ns: int  # first sample with current == target again
    end_reason: EndReason
    columns: Columns
    bad_frame_count: int  # rejected or missing frames of mapped messages inside the cut
    e2e: Mapping[str, E2eState] = field(default_factory=dict)  # message -> INVALID if it ever was, else its last state


@dataclass(frozen=True, slots=True, kw_only=True)
class RunUpEvent:
    """One free engine run-up in neutral with its signals, cut a little wider than the run-up itself.

    It goes from low engine speed through a high peak back to low speed, both clutches open or both closed all along.
    """

    number: int  # 1, 2, ... within the stream
    start_ns: int  # first sample of the engine speed that is no longer low
    end_ns: int  # first sample that is low again
    are_clutches_closed: bool  # else both are empty
    end_reason: EndReason  # abandoned: a gear was chosen
    columns: Columns
    bad_frame_count: int  # rejected or missing frames of mapped messages inside the cut
