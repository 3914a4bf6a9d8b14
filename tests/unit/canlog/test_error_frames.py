"""Error frames: each kind of trouble is told from the bits that Linux gives it."""

import numpy as np
import pytest

from canlog.frames import ERROR_FLAG, BusTrouble, FrameBatch, count_errors
from tests.support.batches import frames_at

CASES = [
    (0x001, 0x00, {BusTrouble.TRANSMIT_TIMEOUT}),
    (0x002, 0x00, {BusTrouble.ARBITRATION_LOST}),
    (0x004, 0x01, {BusTrouble.CONTROLLER_OVERFLOW}),
    (0x004, 0x04, {BusTrouble.ERROR_WARNING}),
    (0x004, 0x20, {BusTrouble.ERROR_PASSIVE}),
    (0x004, 0x40, {BusTrouble.ERROR_ACTIVE}),
    (0x008, 0x00, {BusTrouble.PROTOCOL}),
    (0x088, 0x00, {BusTrouble.PROTOCOL}),
    (0x010, 0x00, {BusTrouble.TRANSCEIVER}),
    (0x020, 0x00, {BusTrouble.NO_ACKNOWLEDGE}),
    (0x040, 0x00, {BusTrouble.BUS_OFF}),
    (0x100, 0x00, {BusTrouble.RESTARTED}),
    (0x200, 0x00, {BusTrouble.OTHER}),
    (0x004, 0x00, {BusTrouble.OTHER}),
    (0x042, 0x00, {BusTrouble.BUS_OFF, BusTrouble.ARBITRATION_LOST}),
    (0x00C, 0x30, {BusTrouble.PROTOCOL, BusTrouble.ERROR_PASSIVE}),
]


def error_frames(*frames: tuple[int, int]) -> FrameBatch:
    """Return error frames of given classes and controller bytes."""
    data = np.zeros((len(frames), 8), np.uint8)
    data[:, 1] = [controller for _, controller in frames]
    return frames_at(range(len(frames)), [ERROR_FLAG | classes for classes, _ in frames], data=data)


@pytest.mark.parametrize(("classes", "controller", "told"), CASES)
def test_every_kind_has_its_bits(classes: int, controller: int, told: set[BusTrouble]) -> None:
    assert count_errors(error_frames((classes, controller))) == dict.fromkeys(told, 1)
