"""What is known of frames besides their signals, as contents of Parquet columns."""

from collections.abc import Sequence
from typing import Final

import numpy as np

from canlog.arrays import Int64Array
from canlog.frames import EXTENDED_FLAG
from canlog.parquet import contents
from canlog.parquet.codes import Packer
from canlog.parquet.contents import Content
from canlog.tables.frame_stock import FrameGroup
from canlog.tables.inputs import Origins
from canlog.tables.layouts import CHANNEL, ID, IS_EXTENDED, LOG, MESSAGE, TIME
from canlog.tables.names import BARE_ID

_BARE_ID: Final = np.uint32(BARE_ID)


def frame_contents(
    group: FrameGroup, messages: Sequence[str], origins: Origins | None, packer: Packer
) -> dict[str, Content]:
    """Return the columns of some frames, at least one; ``messages`` are the names of the codec's messages."""

    def whole_numbers(values: Int64Array, kind: type[np.integer]) -> Content:
        found = packer.numbered(values)
        return contents.whole_numbers(found.distinct.astype(kind), packer.runs(found.index, len(found.distinct)))

    def names(values: Int64Array, of: Sequence[str]) -> Content:
        found = packer.numbered(values)
        different = [of[one] for one in found.distinct.tolist()]
        return contents.names(different, packer.runs(found.index, len(different)))

    can_id = group.frames.can_id
    return {
        **({} if group.log is None or origins is None else {LOG: names(group.log, origins.names)}),
        TIME: contents.times(group.frames.t_ns, packer),
        CHANNEL: whole_numbers(group.channel, np.int64),
        ID: whole_numbers((can_id & _BARE_ID).astype(np.int64), np.int32),
        IS_EXTENDED: contents.flags((can_id & np.uint32(EXTENDED_FLAG)) != 0),
        MESSAGE: names(group.slot, messages),
    }
