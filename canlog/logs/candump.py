"""candump logs (``candump -l``): ``(1767225600.000000) vcan0 0A0#1122334455667788``, FD frames with ``##``, to columns.

Times keep the whole microseconds that candump writes; further digits are cut off. Lines that do not follow the grammar
are counted with the number of the first one, and reading goes on.
"""

from canlog.arrays import Int64Array, UInt8Array
from canlog.frames import FD_PAYLOAD_BYTES, PAYLOAD_BYTES, FrameBatch
from canlog.logs.candump_kernel import parse_lines
from canlog.logs.channels import ChannelNames
from canlog.logs.frame_buffer import FrameRows
from canlog.logs.text_kernels import NEW_CHANNEL, POSITION, STOP
from canlog.logs.text_log import MAX_LINE_BYTES, TextLog


class CandumpLog(TextLog):
    """A log as candump writes it."""

    shortest_line_bytes = 12  # "(0.0)c 123#"

    def __init__(self) -> None:
        super().__init__()
        self._channels = ChannelNames()

    def parse(self, text: UInt8Array, rows: FrameRows, progress: Int64Array) -> None:
        """Read lines; a channel that is met for the first time gets its number."""
        parse_lines(text, rows, self._channels.words, len(self._channels), progress)
        if progress[STOP] == NEW_CHANNEL:
            line = text[progress[POSITION] :][:MAX_LINE_BYTES].tobytes()
            self._channels.add(line.partition(b")")[2].split(maxsplit=1)[0])

    def is_whole(self, line: bytes, frame: FrameBatch) -> bool:  # noqa: ARG002 - the grammar's length decides
        """Return whether a payload is so long that no byte can be missing."""
        return frame.length[0] in {PAYLOAD_BYTES, FD_PAYLOAD_BYTES}
