"""Files in which next to nothing is a log: gigabytes of zeros behind a header are not read to their end."""

import os
from typing import BinaryIO

from canlog.logs.log_counts import LogCounts, LogReject

FREE_BYTES = 256 * 2**20  # may be read before anything is found
BYTES_PER_PIECE = 64 * 2**10  # a frame and all that comes with it take 20 to 200
FREE_REJECTS = 200_000  # pieces that are no frames; some formats take 10 us for each
REJECTS_PER_PIECE = 20


class BoundedStream:
    """A file that ends where no log would go on, which is counted as damage.

    As long as frames or other sound pieces come, it goes on: what is found pays for what is read. ``read_bytes`` is how
    much that is until now.
    """

    def __init__(self, stream: BinaryIO, counts: LogCounts) -> None:
        self._stream = stream
        self._counts = counts
        self.read_bytes = 0
        self._has_ended = False

    @property
    def name(self) -> str:
        """The name of the file."""
        return str(self._stream.name)

    @property
    def is_live(self) -> bool:
        """Whether a reading that is short shall be used at once, as of a pipe."""
        return bool(getattr(self._stream, "is_live", False))

    def read(self, size: int) -> bytes:
        """Return the next bytes; none once it has ended."""
        content = b"" if self._is_at_end() else self._stream.read(size)
        self.read_bytes += len(content)
        return content

    def readinto(self, buffer: "memoryview | bytearray") -> int:
        """Fill the buffer as far as the file goes; 0 once it has ended."""
        got = 0 if self._is_at_end() else int(self._stream.readinto(buffer))  # type: ignore[attr-defined]  # of every one
        self.read_bytes += got
        return got

    def seek(self, position: int, whence: int = os.SEEK_SET) -> int:
        """Go to a position and return it."""
        return self._stream.seek(position, whence)

    def _is_at_end(self) -> bool:
        counts = self._counts
        pieces = counts.frames + counts.skipped
        is_hopeless = (
            self.read_bytes > FREE_BYTES + BYTES_PER_PIECE * pieces
            or sum(counts.rejected.values()) > FREE_REJECTS + REJECTS_PER_PIECE * pieces
        )
        if is_hopeless and not self._has_ended:
            self._has_ended = counts.truncated = True
            counts.reject(LogReject.GIVEN_UP, f"byte {self.read_bytes} or so")
        return self._has_ended
