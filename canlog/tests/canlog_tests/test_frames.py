"""Batches of frames keep all their columns, and error frames their kind."""

import numpy as np
import pytest

from canlog.frames import BRS_FLAG, ERROR_FLAG, FD_FLAG, BusTrouble, FrameBatch, count_errors, empty_batch, join
from tests.support.batches import frames_at


def classic(count: int) -> FrameBatch:
    numbers = np.arange(count)
    return FrameBatch(
        t_ns=numbers * 1_000_000,
        can_id=numbers.astype(np.uint32),
        length=np.full(count, 8, np.uint8),
        data=np.repeat(numbers.astype(np.uint8)[:, None], 8, axis=1),
    )


def fd(count: int) -> FrameBatch:
    numbers = np.arange(count)
    return FrameBatch(
        t_ns=numbers * 1_000_000,
        can_id=numbers.astype(np.uint32),
        length=np.full(count, 48, np.uint8),
        data=np.repeat(numbers.astype(np.uint8)[:, None], 64, axis=1),
        flags=np.full(count, FD_FLAG | BRS_FLAG, np.uint8),
        channel=(numbers % 2).astype(np.uint8),
    )


def test_a_join_is_as_wide_as_its_widest_part() -> None:
    both = join([classic(3), fd(2), classic(1)])
    assert both.width == 64
    assert both.data[:, 7].tolist() == [0, 1, 2, 0, 1, 0]
    assert both.data[:, 8].tolist() == [0, 0, 0, 0, 1, 0]
    assert both.flags.tolist() == [0, 0, 0, FD_FLAG | BRS_FLAG, FD_FLAG | BRS_FLAG, 0]
    assert both.channel.tolist() == [0, 0, 0, 0, 1, 0]
    assert join([classic(3), classic(2), empty_batch()]).width == 8


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
