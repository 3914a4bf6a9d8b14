"""Files of which a library is going to read all are looked at before: they must be plain, and not too large."""

import os
import socket
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from clutch_model.tables import read_toml_file
from clutchdiag_io.files import check_plain_file


def a_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))


OTHERS: Mapping[str, Callable[[Path], None]] = {
    "pipe": os.mkfifo,
    "directory": Path.mkdir,
    "socket": a_socket,
    "device": lambda path: path.symlink_to("/dev/zero"),
}


@pytest.mark.parametrize("use", [check_plain_file, read_toml_file])
@pytest.mark.parametrize("kind", OTHERS)
def test_what_is_no_file_is_refused_at_once(kind: str, use: Callable[[Path], object], tmp_path: Path) -> None:
    path = tmp_path / "it"
    OTHERS[kind](path)
    with pytest.raises(OSError, match=kind):
        use(path)


@pytest.mark.parametrize("use", [check_plain_file, read_toml_file])
def test_sizes_are_limited(use: Callable[[Path], object], tmp_path: Path) -> None:
    path = tmp_path / "it"
    path.write_bytes(b"a = 1")
    use(path)
    os.truncate(path, 2**30)
    with pytest.raises(OSError, match="too large"):
        use(path)


@pytest.mark.parametrize("use", [check_plain_file, read_toml_file])
def test_the_null_device_is_an_empty_file(use: Callable[[Path], object]) -> None:
    use(Path(os.devnull))
