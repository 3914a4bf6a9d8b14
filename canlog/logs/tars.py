"""Tar archives, compressed or not: what files they hold, and the contents of each, without writing any of them.

Headers are read by ``tarfile``; what they state is believed only as far as the archive reaches.
"""

import io
import tarfile
from collections.abc import Iterator
from typing import BinaryIO, Final

from canlog.errors import ExtraMissingError, SourceError
from canlog.logs.compressed import PIECE_BYTES, InflatedStream
from canlog.logs.inflaters import compression_of

TAR_MAGIC, TAR_MAGIC_AT = b"ustar", 257
MOST_HEADER_BYTES: Final = 1024 * 1024  # of one header with its names and attributes, which are read at once


def is_tar(probe: bytes) -> bool:
    """Return whether the first bytes of a file are those of a tar archive that is not compressed."""
    return probe[TAR_MAGIC_AT:].startswith(TAR_MAGIC)


def is_compressed_tar(stream: BinaryIO, probe: bytes) -> bool:
    """Return whether a file with these first bytes is a compressed tar archive; it is at its beginning again."""
    if compression_of(probe) is None:
        return False
    try:
        return is_tar(TarContents(stream, probe).read(tarfile.BLOCKSIZE))
    except (SourceError, ExtraMissingError):
        return False  # whoever reads it is told why
    finally:
        stream.seek(0)


class _Inflated(InflatedStream):
    """As what it is made from, but the file stays open: it is read again."""

    def close(self) -> None:
        """Leave the file open."""
        io.RawIOBase.close(self)


class TarContents:
    """What is in a file, or in what is compressed there; going forward in it costs least."""

    def __init__(self, stream: BinaryIO, probe: bytes) -> None:
        compression = compression_of(probe)
        stream.seek(0)
        self._file = stream
        self._inflated = None if compression is None else _Inflated(stream, compression)
        self._at = 0

    def tell(self) -> int:
        """Return the position."""
        return self._at

    def seek(self, position: int) -> None:
        """Go to a position; behind the end there is nothing to be read."""
        if self._inflated is None:
            self._file.seek(position)
            self._at = position
            return
        if position < self._at:
            self._inflated = _Inflated(self._file, self._inflated.kind)
            self._at = 0
        while self._at < position and self._next(min(PIECE_BYTES, position - self._at)):
            pass

    def read(self, size: int) -> bytes:
        """Return so many bytes, fewer at the end; raises SourceError if that is more than a header has."""
        if not 0 <= size <= MOST_HEADER_BYTES:
            raise SourceError(f"the tar archive has a header of {size} bytes: more than any name needs")
        pieces = list[bytes]()
        while size and (piece := self._next(size)):
            pieces.append(piece)
            size -= len(piece)
        return b"".join(pieces)

    def _next(self, most_bytes: int) -> bytes:
        piece = (self._inflated or self._file).read(most_bytes) or b""
        self._at += len(piece)
        return piece


class TarMember:
    """The contents of one file in a tar archive."""

    def __init__(self, contents: TarContents, info: tarfile.TarInfo) -> None:
        self._contents = contents
        self._at, self._end = info.offset_data, info.offset_data + info.size

    def read1(self, size: int) -> bytes:
        """Return up to so many bytes, none at the end; raises EOFError if the archive ends before."""
        wanted = min(size, self._end - self._at)
        self._contents.seek(self._at)
        piece = self._contents.read(wanted) if self._contents.tell() == self._at else b""
        self._at += len(piece)
        if wanted and not piece:
            raise EOFError
        return piece


def tar_infos(contents: TarContents) -> Iterator[tarfile.TarInfo]:
    """Yield what a tar archive holds besides folders, in its order.

    Raises SourceError if it is damaged, or ends before its last file does.
    """
    try:
        archive = tarfile.TarFile(fileobj=contents, mode="r")  # type: ignore[arg-type]  # a file as far as it is used
        last_at = -1
        while (info := archive.next()) is not None:
            if info.size < 0 or info.offset <= last_at:
                raise SourceError("the tar archive is damaged: a size is negative")
            last_at = info.offset
            archive.members.clear()  # type: ignore[attr-defined]  # else it keeps all, folders too
            if not info.isdir():
                yield info
        contents.seek(archive.offset)
        if contents.read(tarfile.BLOCKSIZE).strip(b"\0"):
            raise SourceError("the tar archive is damaged: what follows its last readable file is not a header")
    except (tarfile.TarError, ValueError, OverflowError, IndexError, EOFError, KeyError) as exc:
        raise SourceError(f"the tar archive is damaged: {exc}") from exc


def tar_refusal(info: tarfile.TarInfo) -> str:
    """Return why a file in a tar archive cannot be read; empty if it can."""
    if info.issym() or info.islnk():
        return "it is a link: unpack it first"
    if not info.isreg():
        return "it is a device or the like, not a file"
    return "it is a sparse file: unpack it first" if info.issparse() else ""
