"""What became of the frames of a run, or of the values of a table, in numbers and in words."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Final

NAMED_SIGNALS: Final = 3  # of those that lost values


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameCounts:
    """Frames of one run. ``on_bus = decoded + ignored + rejected + unsupported + dropped``, to the frame.

    Of a table of signals each value counts as one.
    """

    on_bus: int = 0  # seen by the interface or in the log, those lost on the way included
    decoded: int = 0
    ignored: int = 0  # of messages that the service does not use
    unsupported: int = 0  # neither CAN nor CAN FD
    kernel_dropped: int = 0
    queue_dropped: int = 0
    rejected: Mapping[str, int] = field(default_factory=dict)  # reason -> frames
    missing: int = 0  # never on this side of the bus, as alive counters tell
    late: int = 0  # held back on the way: they came in bursts, or behind frames that were sent later
    invalid_values: int = 0  # not available or out of range, in decoded frames
    invalid: Mapping[str, Mapping[str, int]] = field(default_factory=dict)  # the same: signal -> reason -> values
    invalid_at_first: Mapping[str, int] = field(default_factory=dict)  # of these before a signal's first real value
    content: str = "frames"  # what is counted, for people
    unreadable: Mapping[str, int] = field(default_factory=dict)  # lines or objects of a log, reason -> count

    @property
    def rejected_count(self) -> int:
        return sum(self.rejected.values())

    @property
    def is_balanced(self) -> bool:
        dropped = self.kernel_dropped + self.queue_dropped
        return self.on_bus == self.decoded + self.ignored + self.unsupported + self.rejected_count + dropped


def frames_line(frames: FrameCounts) -> str:
    """Return the frame numbers as one line for people."""
    parts = [f"{frames.on_bus} {frames.content}", f"{frames.decoded} decoded", f"{frames.ignored} ignored"]
    parts.append(with_reasons(f"{frames.rejected_count} rejected", frames.rejected))
    if frames.unsupported:
        parts.append(f"{frames.unsupported} neither CAN nor CAN FD")
    parts.append(f"{frames.kernel_dropped + frames.queue_dropped} dropped")
    parts.append(f"{frames.missing} missing")
    if frames.late:
        parts.append(f"{frames.late} late, in bursts or behind later ones")
    parts.append(f"{frames.invalid_values} values not available")
    if any(frames.unreadable.values()):
        parts.append(with_reasons("unreadable in the log", frames.unreadable))
    return ", ".join(parts)


def values_line(frames: FrameCounts) -> str:
    """Return which signals lost values after they had any, as one line for people; empty if none did."""
    lost = {
        signal: sum(reasons.values()) - frames.invalid_at_first.get(signal, 0)
        for signal, reasons in sorted(frames.invalid.items())
    }
    most = sorted((signal for signal in lost if lost[signal] > 0), key=lambda signal: -lost[signal])
    if not most:
        return ""
    named = ", ".join(f"{signal} ({lost[signal]})" for signal in most[:NAMED_SIGNALS])
    rest = len(most) - NAMED_SIGNALS
    more = f" and {rest} more signal{'s' if rest > 1 else ''}" if rest > 0 else ""
    count, plural = sum(lost[signal] for signal in most), "s" if len(most) > 1 else ""
    values = f"{count} values of {len(most)} signal{plural} were no measurements"
    if count == 1:
        values = "1 value of 1 signal was no measurement"
    return f"{values} after the first real one: {named}{more}"


def with_reasons(head: str, counts: Mapping[str, int]) -> str:
    named = [f"{count} {name.replace('_', ' ')}" for name, count in counts.items() if count]
    return f"{head} ({', '.join(named)})" if named else head
