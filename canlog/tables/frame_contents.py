"""What is known of frames besides their signals, as contents of Parquet columns."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from canlog.arrays import Int64Array
from canlog.frames import EXTENDED_FLAG
from canlog.parquet import contents
from canlog.parquet.codes import Packer
from canlog.parquet.contents import Content
from canlog.parquet.packing import Int32Array
from canlog.tables.frame_stock import FrameGroup
from canlog.tables.inputs import Origins
from canlog.tables.layouts import CHANNEL, ID, IS_EXTENDED, LOG, MESSAGE, TIME
from canlog.tables.names import BARE_ID

_BARE_ID: Final = np.uint32(BARE_ID)


def frame_contents(
    group: FrameGroup,
    messages: Sequence[str],
    origins: Origins | None,
    packer: Packer,
    repeats: Int32Array | None = None,
) -> dict[str, Content]:
    """Return the columns of some frames, or of rows of which frame k has ``repeats[k]``.

    ``messages`` are the names of the codec's messages. At least one row is asked for.
    """

    def packed(index: Int32Array, value_count: int) -> bytes:
        if repeats is None:
            return packer.runs(index, value_count)
        return packer.repeated(index, repeats, value_count)

    def whole_numbers(values: Int64Array, kind: type[np.integer]) -> Content:
        found = packer.numbered(values)
        return contents.whole_numbers(found.distinct.astype(kind), packed(found.index, len(found.distinct)))

    def names(values: Int64Array, of: Sequence[str]) -> Content:
        found = packer.numbered(values)
        return contents.names([of[one] for one in found.distinct.tolist()], packed(found.index, len(found.distinct)))

    frames = group.frames
    is_extended = (frames.can_id & np.uint32(EXTENDED_FLAG)) != 0
    found = {} if group.log is None or origins is None else {LOG: names(group.log, origins.names)}
    if repeats is None:
        found[TIME] = contents.times(frames.t_ns, packer)
    else:
        numbers = np.arange(len(group), dtype=np.int32)
        found[TIME] = contents.whole_numbers(frames.t_ns, packer.repeated(numbers, repeats, len(numbers)))
        is_mixed = is_extended.any() and not is_extended.all()
        row_count = int(repeats.sum())
        is_extended = np.repeat(is_extended, repeats) if is_mixed else np.full(row_count, is_extended[0])
    found[CHANNEL] = whole_numbers(group.channel, np.int64)
    found[ID] = whole_numbers((frames.can_id & _BARE_ID).astype(np.int64), np.int32)
    found[IS_EXTENDED] = contents.flags(is_extended)
    found[MESSAGE] = names(group.slot, messages)
    return found
