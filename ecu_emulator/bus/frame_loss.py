"""Frames that never reach the receiver: each is lost by itself, at random."""

import numpy as np

from ecu_emulator.bus.frames import EncodedFrames
from ecu_emulator.scenario.signals import generator


class FrameLoss:
    """Loses a share of the frames; which ones depends on the seed only, not on how the stream was cut."""

    def __init__(self, loss_ratio: float, seed: int) -> None:
        self._loss_ratio = loss_ratio
        self._random = generator(seed, "frame loss")

    def surviving(self, frames: EncodedFrames) -> EncodedFrames:
        """Return the frames that arrive; alive counters show the gaps."""
        if self._loss_ratio == 0.0:
            return frames
        kept = np.flatnonzero(self._random.random(len(frames)) >= self._loss_ratio)
        return EncodedFrames(
            t_s=frames.t_s[kept], can_id=frames.can_id[kept], length=frames.length[kept], data=frames.data[kept]
        )
