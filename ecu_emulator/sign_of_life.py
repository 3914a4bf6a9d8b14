"""A file whose age tells whether frames go out: what a container's health check can look at."""

import os
from contextlib import suppress
from pathlib import Path

from ecu_emulator.errors import RecordError


class SignOfLife:
    """Touches a file whenever it is told of more frames than before; until then the file is from 1970.

    Raises
    ------
    RecordError
        If the file cannot be made.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._frame_count = 0
        try:
            path.touch()
            os.utime(path, (0.0, 0.0))
        except OSError as exc:
            raise RecordError(f"cannot touch {path}: {exc.strerror}") from exc

    def tell(self, frame_count: int) -> None:
        """Touch the file if frames were sent since the last time."""
        if frame_count <= self._frame_count:
            return
        self._frame_count = frame_count
        with suppress(OSError):  # a file that cannot be touched any more grows old, which says enough
            self._path.touch()
