"""Frames to groups of rows: which messages they are, what their signals say, and the account of both."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from canlog.decode.codec import Codec, MessageValues
from canlog.frames import FrameBatch
from canlog.tables.account import DecodeAccount
from canlog.tables.frame_stock import FrameGroup, FrameStock
from canlog.tables.inputs import Origins
from canlog.tables.layouts import LongLayout, WideLayout
from canlog.tables.long_rows import LongRows, Stretch


@dataclass(frozen=True, slots=True, kw_only=True)
class GroupSize:
    """How much a group of rows holds at most."""

    frames: int
    values: int
    is_live: bool = False  # somebody waits for the rows: what came together is a group, however few frames that are


def stretches(
    batches: Iterable[FrameBatch], account: DecodeAccount, pairs: Collection[tuple[int, int]] = ()
) -> Iterator[Stretch]:
    """Yield frames with their messages, and with those messages that several frames are; all enter the account."""
    together = LongRows(account.codec, pairs)
    account.transfers, account.long_counts = together.counts, together.counts_of
    for stretch in together.stretches(batches):
        account.add(stretch)
        yield stretch


def groups(
    found: Iterable[Stretch], codec: Codec, size: GroupSize, origins: Origins | None = None
) -> Iterator[FrameGroup]:
    """Yield the frames that have signals, in groups."""
    stock = FrameStock.of(codec, origins, size.frames, size.values)
    for stretch in found:
        yield from stock.add(stretch)
        if size.is_live:
            yield from stock.rest()
    yield from stock.rest()


def values_in(group: FrameGroup, account: DecodeAccount) -> list[MessageValues]:
    """Return what the signals of a group say, message by message; it enters the account."""
    found = list(account.codec.decode_slots(group.frames, group.slot_in_frames, group.has_short))
    if group.long is not None:
        found += group.long.values(account.codec)
    for one in found:
        account.add_values(one)
    return found


def columns_of(group: FrameGroup, account: DecodeAccount, layout: WideLayout | LongLayout) -> Mapping[str, Any]:
    """Return the columns of a group, empty if it has no rows; values and rows enter the account."""
    found = values_in(group, account)
    count, columns = layout.columns(group, found) if found else (0, {})
    account.row_count += count
    return columns if count else {}
