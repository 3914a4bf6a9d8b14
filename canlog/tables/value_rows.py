"""Values of signals, each in the order of its frames, as rows in the order of frames: a compiled loop."""

from typing import NamedTuple

from canlog.arrays import BoolArray, Int64Array
from canlog.jit import array_kernel
from canlog.parquet.packing import Int32Array


class SignalRuns(NamedTuple):
    """Where the values of s signals are, signal by signal; those of one message are neighbours, in its order.

    Signals that the same frames carry share a run of frames, of which there are r.
    """

    begin: Int64Array  # (messages + 1,) where the signals of a message begin
    is_shared: BoolArray  # (messages,) all signals of a message are in all of its frames
    run: Int64Array  # (s,) the run of frames of each signal
    first: Int64Array  # (s,) place of its first value
    frame: Int64Array  # (f,) the frames of all runs
    run_begin: Int64Array  # (r + 1,) where the frames of a run begin


@array_kernel
def values_by_frame(
    slot: Int64Array, runs: SignalRuns, number: Int32Array, cursor: Int64Array, value: Int32Array, signal: Int32Array
) -> int:
    """Fill in the rows of all frames: number of each value and of its signal; return how many there are.

    ``number`` are those of all values, signal by signal; ``cursor``, zeros at first, says how many of each run of
    frames have been written.
    """
    row = 0
    for frame in range(slot.size):
        first, stop = runs.begin[slot[frame]], runs.begin[slot[frame] + 1]
        if runs.is_shared[slot[frame]]:
            run = runs.run[first]
            done = cursor[run]
            for one in range(first, stop):
                value[row] = number[runs.first[one] + done]
                signal[row] = one
                row += 1
            cursor[run] = done + 1
            continue
        for one in range(first, stop):
            run = runs.run[one]
            at = runs.run_begin[run] + cursor[run]
            if at < runs.run_begin[run + 1] and runs.frame[at] == frame:
                value[row] = number[runs.first[one] + cursor[run]]
                signal[row] = one
                row += 1
        for one in range(first, stop):
            run = runs.run[one]
            at = runs.run_begin[run] + cursor[run]
            if at < runs.run_begin[run + 1] and runs.frame[at] == frame:
                cursor[run] += 1
    return row
