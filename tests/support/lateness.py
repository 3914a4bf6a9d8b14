"""Frames that were received late: what a machine that was busy for a while makes of a drive."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from canlog.frames import FrameBatch

NS_PER_S = 1_000_000_000


def after_stalls(batch: FrameBatch, stalls_s: Sequence[tuple[float, float]], step_s: float) -> FrameBatch:
    """Return frames as received by somebody who did nothing in some stretches, each a begin and a length [s].

    What has gathered comes behind a stretch, a frame every ``step_s`` until all is on time again.
    """
    first_ns, step_ns = int(batch.t_ns[0]), round(step_s * NS_PER_S)
    busy_ns = [(first_ns + round(at * NS_PER_S), first_ns + round((at + for_s) * NS_PER_S)) for at, for_s in stalls_s]
    received, free_ns = np.empty_like(batch.t_ns), 0
    for row, sent_ns in enumerate(batch.t_ns.tolist()):
        is_late = sent_ns < free_ns
        at_ns = free_ns if is_late else sent_ns
        for begin_ns, end_ns in busy_ns:
            if begin_ns <= at_ns < end_ns:
                at_ns, is_late = end_ns, True
        received[row] = at_ns
        free_ns = at_ns + step_ns if is_late else at_ns
    return replace(batch, t_ns=received)
