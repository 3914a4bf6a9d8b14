"""Types of arrays, and samples of one signal as a decoder makes them of its frames."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]
Int64Array = npt.NDArray[np.int64]
UInt8Array = npt.NDArray[np.uint8]
UInt32Array = npt.NDArray[np.uint32]
UInt64Array = npt.NDArray[np.uint64]
Records = npt.NDArray[np.void]  # of a type with names


@dataclass(frozen=True, slots=True, kw_only=True)
class Series:
    """Samples of one signal, oldest first; invalid samples were left out and counted before.

    ``sequence`` numbers the transmissions of the message (unwrapped alive counter, gaps where frames are
    missing); without a counter in the DBC it is all -1. ``period_ns`` is the nominal cycle time, 0 if unknown; in
    an event it is the message's own, where that is plainly longer.
    """

    t_ns: Int64Array  # (n,)
    sequence: Int64Array  # (n,)
    value: FloatArray  # (n,), finite
    period_ns: int = 0

    def copy(self) -> "Series":
        """Return the samples in arrays of their own."""
        return Series(
            t_ns=self.t_ns.copy(), sequence=self.sequence.copy(), value=self.value.copy(), period_ns=self.period_ns
        )

    def between(self, start_ns: int, stop_ns: int) -> "Series":
        """Return the samples with ``start_ns <= t_ns < stop_ns``."""
        first, last = self.t_ns.searchsorted((start_ns, stop_ns))
        return Series(
            t_ns=self.t_ns[first:last],
            sequence=self.sequence[first:last],
            value=self.value[first:last],
            period_ns=self.period_ns,
        )
