"""Files that are read whole are plain and small, or an error; nothing is waited for that nobody promised."""

import os
import socket
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from canlog.files import check_plain_file, read_small_file, read_toml_file


def a_socket(path: Path) -> None:
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))


OTHERS: Mapping[str, Callable[[Path], None]] = {
    "pipe": os.mkfifo,
    "directory": Path.mkdir,
    "socket": a_socket,
    "device": lambda path: path.symlink_to("/dev/zero"),
}


@pytest.mark.parametrize("kind", OTHERS)
def test_what_is_no_file_is_refused_at_once(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "it"
    OTHERS[kind](path)
    for use in (read_small_file, check_plain_file, read_toml_file):
        with pytest.raises(OSError, match=kind):
            use(path)


def test_sizes_are_limited_whatever_the_file_system_says(tmp_path: Path) -> None:
    path = tmp_path / "it"
    path.write_bytes(b"12345")
    assert read_small_file(path, 5) == b"12345"
    for use in (read_small_file, check_plain_file):
        with pytest.raises(OSError, match="too large"):
            use(path, 4)
    assert b"Name:" in read_small_file(Path("/proc/self/status"))  # which claims to have no bytes
    with pytest.raises(OSError, match="too large"):
        read_small_file(Path("/proc/self/status"), 4)
