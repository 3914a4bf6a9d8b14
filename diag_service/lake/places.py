"""Places that hold files: a folder, or a prefix in an object store, by the libraries of fsspec.

Where a store is, who may enter it and how often it is asked again says its own library, never what is read.
"""

import logging
import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Any, Final

from canlog.errors import SourceError
from canlog.extras import load_extra
from canlog.files import replacing
from diag_service.errors import ConfigError, StoreError

UNFINISHED: Final = ".part"
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Held:
    """A file in a place, as it was when it was looked at."""

    name: str  # below the place, parts separated by /
    size_bytes: int
    mark: str  # differs when the content was written anew: entity tag or time of change


class Place:
    """A folder of this machine, or of an object store; what is put there appears whole or not at all.

    In a folder a file is written aside, synced and renamed. In an object store a put is atomic by itself.

    Raises ConfigError if the address names no place, ExtraMissingError if the library for it is not installed, and
    from every method StoreError if the store does not do what is asked.
    """

    def __init__(self, address: str) -> None:
        if "::" in address:
            raise ConfigError(f"{address}: one store at a time, not one inside another")
        core = load_extra("fsspec.core", "a store needs fsspec", "cluster", ".")
        below = load_extra("fsspec.implementations.dirfs", "a store needs fsspec", "cluster", ".")
        if "://" not in address:
            address = str(Path(address).absolute())
        try:
            files, root = core.url_to_fs(address, use_listings_cache=False)
        except ImportError as exc:
            raise ConfigError(f"{address}: {exc}") from exc
        except (ValueError, OSError, TypeError) as exc:
            raise ConfigError(f"{address} is not a store: {exc}") from exc
        self._files = below.DirFileSystem(root.rstrip("/"), files)  # names are below the place
        self.address = address.rstrip("/")
        self.is_local = "file" in ((files.protocol,) if isinstance(files.protocol, str) else files.protocol)

    def held(self, under: str = "", *, with_unfinished: bool = False) -> dict[str, Held]:
        """Return the files below, by name; none where there is no such folder.

        What a killed process has not finished writing is none of them, unless it is asked for. A folder of this machine
        that nobody may look into is told.
        """
        with _translated("look into", self.address):
            try:
                self._files.invalidate_cache()
                listed = self._walked(under) if self.is_local else self._files.find(under, detail=True)
            except FileNotFoundError:
                return {}
        held = (_held(name, info) for name, info in sorted(listed.items()) if name and info["type"] == "file")
        return {one.name: one for one in held if with_unfinished or not one.name.endswith(UNFINISHED)}

    @contextmanager
    def opened(self, name: str) -> Iterator[Any]:
        """Give a file for reading."""
        with _translated("read", self._shown(name)), self._files.open(name, "rb") as file:
            yield file

    def brought(self, name: str, folder: Path) -> Path:
        """Return where a file lies on this machine, in ``folder`` if it came from elsewhere.

        Raises SourceError, too, if this file alone has gone or is archived: the store still answers.
        """
        if self.is_local:
            return Path(self._files.path, name)
        path = folder / PurePosixPath(name).name
        with _translated("read", self._shown(name)):
            try:
                self._files.get_file(name, str(path))
            except (FileNotFoundError, PermissionError) as exc:
                with suppress(FileNotFoundError):
                    self._files.info(name)  # where the store tells nothing any more, it is not about one file
                raise SourceError(f"cannot read {self._shown(name)}: {exc}") from exc
        return path

    def put(self, name: str, source: Path) -> None:
        """Copy a file there; it takes the place of one of that name."""
        with _translated("write", self._shown(name)):
            if not self.is_local:
                self._files.put_file(str(source), name)
                return
            path = Path(self._files.path, name)
            path.parent.mkdir(parents=True, exist_ok=True)
            with replacing(path, StoreError) as part:
                with source.open("rb") as read, part.open("wb") as written:
                    shutil.copyfileobj(read, written)
                    written.flush()
                    os.fsync(written.fileno())
                part.replace(path)

    def remove(self, names: Iterable[str]) -> None:
        """Remove files, of which some may be gone, and on this machine the folders that then hold nothing."""
        for name in names:
            with _translated("remove", self._shown(name)), suppress(FileNotFoundError):
                self._files.rm_file(name)
            if self.is_local:
                with suppress(OSError):  # it holds something
                    Path(self._files.path, name).parent.rmdir()

    def _shown(self, name: str) -> str:
        return f"{self.address}/{name}"

    def _walked(self, under: str) -> dict[str, Any]:
        """Return the files below a folder of this machine; fsspec tells of no folder that it may not read."""
        listed = dict[str, Any]()
        for folder, _, names in os.walk(Path(self._files.path, under), onerror=_tell):
            for name in (Path(folder, name).relative_to(self._files.path).as_posix() for name in names):
                listed[name] = {"type": "file", "size": 0}
                with suppress(FileNotFoundError):  # a link that leads nowhere: a file that nobody can read
                    listed[name] = self._files.info(name)
        return listed


def _held(name: str, info: Mapping[str, Any]) -> Held:
    mark = info.get("ETag") or info.get("etag") or info.get("mtime") or info.get("updated") or ""
    return Held(name=name, size_bytes=int(info["size"]), mark=str(mark))


def _tell(error: OSError) -> None:
    if isinstance(error, PermissionError):  # else it is not there, or has gone meanwhile
        _LOG.warning("left out: %s: %s", error.filename, error.strerror)


@contextmanager
def _translated(verb: str, what: str) -> Iterator[None]:
    """Raise StoreError in place of what a library raises."""
    try:
        yield
    except (SourceError, StoreError):
        raise
    except Exception as exc:  # each library of a store has errors of its own, without a common root
        raise StoreError(f"cannot {verb} {what}: {exc or type(exc).__name__}") from exc
