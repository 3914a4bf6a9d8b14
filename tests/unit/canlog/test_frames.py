"""Batches keep all their columns, whatever is done to them."""

import numpy as np

from canlog.frames import BRS_FLAG, FD_FLAG, FrameBatch, empty_batch, join


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
