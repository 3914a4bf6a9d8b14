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


def sent_by_a_slow_machine(batch: FrameBatch, seed: int) -> FrameBatch:
    """Return frames as sent by somebody who in some stretches takes up to twice the time, and now and then pauses."""
    rng = np.random.default_rng(seed)
    slowness = np.ones(len(batch))
    for begin in rng.integers(0, len(batch), rng.integers(1, 30)).tolist():
        slowness[begin : begin + int(rng.integers(20, 800))] = rng.uniform(1.0, 2.2)
    steps_ns = np.diff(batch.t_ns, prepend=batch.t_ns[0]) * slowness
    slow = replace(batch, t_ns=batch.t_ns[0] + np.cumsum(steps_ns).astype(np.int64))
    length_s = 1e-9 * float(slow.t_ns[-1] - slow.t_ns[0])
    pauses_s = np.column_stack((np.sort(rng.uniform(0.0, length_s, 8)), rng.exponential(0.03, 8)))
    return after_stalls(slow, [(at, for_s) for at, for_s in pauses_s.tolist()], 3e-4)
