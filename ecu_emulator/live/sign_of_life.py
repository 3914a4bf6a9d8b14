"""A file whose age tells whether frames go out: what a container's health check can look at."""

from pathlib import Path

from clutchdiag_io.sign_of_life import give_sign, make_sign
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
            make_sign(path)
        except OSError as exc:
            raise RecordError(f"cannot touch {path}: {exc.strerror}") from exc

    def tell(self, frame_count: int) -> None:
        """Touch the file if frames were sent since the last time."""
        if frame_count > self._frame_count:
            self._frame_count = frame_count
            give_sign(self._path)
