"""What is wrong with a log, in words for people: the same wherever a log is told of."""

from collections.abc import Iterator

from canlog.logs.log_counts import LogCounts


def lost_texts(counts: LogCounts) -> Iterator[str]:
    """Yield what of a log was not read though it should have been."""
    if counts.truncated:
        yield "the log is cut off"
    if counts.first_rejected:
        reasons = ", ".join(f"{count} {reason.replace('_', ' ')}" for reason, count in counts.rejected.items() if count)
        total = sum(counts.rejected.values())
        yield f"{total} pieces of the log are not frames ({reasons}), the first: {counts.first_rejected}"


def assumed_texts(counts: LogCounts) -> Iterator[str]:
    """Yield what had to be assumed about a log, such as a unit, or that nothing is missing at its end."""
    yield from counts.notes
    if counts.unfinished and not counts.truncated:
        yield "the recorder did not close the log, so frames may be missing at its end"


def odd_texts(counts: LogCounts) -> Iterator[str]:
    """Yield what is odd about the frames that were read: times that jump, frames that are there twice."""
    if jumps := counts.jumps_back + counts.jumps_ahead:
        yield f"{jumps} jumps of time, {counts.jumps_back} of them back, the first: {counts.first_jump}"
    if counts.repeated:
        yield f"{counts.repeated} frames repeat the one before, time included"
