"""Several streams of frames, each in its own order, as one in the order of time."""

from collections.abc import Iterable, Iterator

import numpy as np

from diag_service.frames import FrameBatch
from diag_service.sources.columns import join


def merged_by_time(streams: Iterable[Iterator[FrameBatch]]) -> Iterator[FrameBatch]:
    """Yield the frames of all streams; of frames with the same time those of an earlier stream come first.

    Each stream is held one batch ahead. Where its time jumps back its frames stay in their order.
    """
    waiting = [(stream, batch) for stream in streams if (batch := _next(stream)) is not None]
    while len(waiting) > 1:
        horizon_ns = min(int(batch.t_ns[-1]) for _, batch in waiting)
        due = [_due(batch, horizon_ns) for _, batch in waiting]
        if not any(due):  # the time of every stream jumps back: the one that is behind goes on as it is
            first = min(range(len(waiting)), key=lambda index: int(waiting[index][1].t_ns[0]))
            due[first] = len(waiting[first][1])
        taken = [batch[:count] for (_, batch), count in zip(waiting, due, strict=True) if count]
        yield taken[0] if len(taken) == 1 else _sorted(join(taken))
        left = [(stream, batch[count:]) for (stream, batch), count in zip(waiting, due, strict=True)]
        refilled = [(stream, batch if len(batch) else _next(stream)) for stream, batch in left]
        waiting = [(stream, batch) for stream, batch in refilled if batch is not None]
    for stream, batch in waiting:
        yield batch
        yield from (rest for rest in stream if len(rest))


def _next(stream: Iterator[FrameBatch]) -> FrameBatch | None:
    """Return the next batch that holds a frame."""
    return next((batch for batch in stream if len(batch)), None)


def _sorted(batch: FrameBatch) -> FrameBatch:
    return batch[np.argsort(batch.t_ns, kind="stable")]


def _due(batch: FrameBatch, horizon_ns: int) -> int:
    """Return how many frames from the first come no later."""
    later = np.flatnonzero(batch.t_ns > horizon_ns)
    return int(later[0]) if len(later) else len(batch)
