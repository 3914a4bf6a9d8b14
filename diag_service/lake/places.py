"""Places that hold files: a folder, or a prefix in an object store, by the libraries of fsspec.

Where a store is and who may enter it says its own library (environment, its settings files), never what is read.
"""

import hashlib
import logging
import os
import random
import time
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeVar

from canlog.extras import load_extra
from canlog.files import replacing
from diag_service.errors import ConfigError, StoreError

ATTEMPTS: Final = 7
UNFINISHED: Final = ".part"
FIRST_PAUSE_S: Final = 0.2  # doubled each time: 13 s in all, then the run stops and the same command goes on
_FINAL: Final = (FileNotFoundError, PermissionError, IsADirectoryError, NotADirectoryError)
_Answer = TypeVar("_Answer")
_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class Held:
    """A file in a place, as it was when it was looked at."""

    name: str  # below the place, parts separated by /
    size_bytes: int
    mark: str  # differs when the content was written anew: entity tag or time of change

    def key(self, place: str, vehicle: str) -> str:
        """Return what tells this file, as one of a vehicle, from any other and from an earlier state of it."""
        parts = (place, self.name, str(self.size_bytes), self.mark, vehicle)
        return hashlib.sha256("\0".join(parts).encode(errors="surrogateescape")).hexdigest()


class Place:
    """A folder of this machine, or of an object store; what is put there appears whole or not at all.

    In a folder a file is written aside, synced and renamed. In an object store a put is atomic by itself: until its
    last byte has come, and was found to be right, the object is the one before.

    Raises
    ------
    ConfigError
        If the address names no place, or its library does not know it.
    ExtraMissingError
        If the library for it is not installed.
    StoreError
        From every method, if the store does not do what is asked, not even after several attempts.
    """

    def __init__(self, address: str) -> None:
        if "::" in address:
            raise ConfigError(f"{address}: one store at a time, not one inside another")
        core = load_extra("fsspec.core", "a store needs fsspec", "cluster")
        if "://" not in address:
            address = str(Path(address).absolute())
        try:
            self._files, self._root = core.url_to_fs(address, use_listings_cache=False)
        except ImportError as exc:
            raise ConfigError(f"{address}: {exc}") from exc
        except (ValueError, OSError, TypeError) as exc:
            raise ConfigError(f"{address} is not a store: {exc}") from exc
        self._root = self._root.rstrip("/")
        self.address = address.rstrip("/")
        protocols = self._files.protocol
        self.is_local = "file" in ((protocols,) if isinstance(protocols, str) else protocols)

    def held(self, under: str = "", *, with_unfinished: bool = False) -> dict[str, Held]:
        """Return the files below, by name; none where there is no such folder.

        What a killed process has not finished writing is none of them, unless it is asked for.
        """

        def found() -> dict[str, Held]:
            try:
                self._files.invalidate_cache()
                top = f"{self._root}/{under}".rstrip("/")
                listed: Mapping[str, Any] = self._walked(top) if self.is_local else self._files.find(top, detail=True)
            except FileNotFoundError:
                return {}
            every = (self._held(path, info) for path, info in sorted(listed.items()))
            known = (one for one in every if one is not None)
            return {one.name: one for one in known if with_unfinished or not one.name.endswith(UNFINISHED)}

        return _patiently("look into", self.address, found)

    def folders(self, under: str) -> list[str]:
        """Return the folders right below, by name; none where there is no such folder."""

        def found() -> list[str]:
            try:
                listed = self._files.ls(self._full(under), detail=True)
            except FileNotFoundError:
                return []
            paths = (str(one["name"]).rstrip("/") for one in listed if one["type"] == "directory")
            return sorted(path.removeprefix(self._root).lstrip("/") for path in paths)

        return _patiently("look into", self._shown(under), found)

    def read(self, name: str) -> bytes:
        content: bytes = _patiently("read", self._shown(name), lambda: self._files.cat_file(self._full(name)))
        return content

    def path(self, name: str) -> Path | None:
        """Return where a file lies on this machine; None if it lies elsewhere and is to be fetched."""
        return Path(self._full(name)) if self.is_local else None

    def fetch(self, name: str, target: Path) -> None:
        """Copy a file to this machine."""
        _patiently("read", self._shown(name), lambda: self._files.get_file(self._full(name), str(target)))

    def has_refused(self, name: str, error: StoreError) -> bool:
        """Return whether an error is about one file alone, which has gone or is archived: the store still answers."""
        if not isinstance(error.__cause__, FileNotFoundError | PermissionError):
            return False
        try:
            _patiently("look at", self._shown(name), lambda: self._files.info(self._full(name)))
        except StoreError as exc:
            return isinstance(exc.__cause__, FileNotFoundError)
        return True

    def put(self, name: str, source: Path) -> None:
        """Copy a file there; it takes the place of one of that name."""
        if self.is_local:
            _patiently("write", self._shown(name), lambda: _put_locally(Path(self._full(name)), source))
        else:
            _patiently("write", self._shown(name), lambda: self._files.put_file(str(source), self._full(name)))

    def remove(self, names: Iterable[str]) -> int:
        """Remove files; return how many there were: one that is gone already is not counted."""
        return sum(_patiently("remove", self._shown(name), partial(self._remove, name)) for name in names)

    def remove_folders(self, pattern: str) -> list[str]:
        """Remove folders that hold nothing; return the names of those that are left. Object stores have no folders."""
        if not self.is_local:
            return []
        found = list(Path(self._root).glob(pattern))
        for folder in found:
            with suppress(OSError):  # it holds something: it is told
                folder.rmdir()
        return [folder.relative_to(self._root).as_posix() for folder in found if folder.exists()]

    def _remove(self, name: str) -> bool:
        is_there = bool(self._files.exists(self._full(name)))
        if is_there:
            self._files.rm_file(self._full(name))
        return is_there

    def _walked(self, top: str) -> dict[str, Any]:
        """Return the files below a folder of this machine; a folder that nobody may look into is told."""
        found, waiting = dict[str, Any](), [top]
        while waiting:
            folder, listed = waiting.pop(), list[Any]()
            try:
                listed = self._files.ls(folder, detail=True)
            except (FileNotFoundError, PermissionError) as exc:
                if isinstance(exc, PermissionError):  # else it is not there, or has gone meanwhile
                    _LOG.warning("left out: %s: %s", folder, exc.strerror)
            waiting += [one["name"] for one in listed if one["type"] == "directory"]
            found |= {one["name"]: one for one in listed if one["type"] != "directory"}
        return found

    def _full(self, name: str) -> str:
        return f"{self._root}/{name}"

    def _shown(self, name: str) -> str:
        return f"{self.address}/{name}"

    def _held(self, path: str, info: Mapping[str, Any]) -> Held | None:
        name = path.removeprefix(self._root).lstrip("/")
        if info.get("islink"):
            try:
                info = self._files.info(path)
            except FileNotFoundError:  # it leads nowhere: a file that nobody can read
                info = {**info, "type": "file"}
        if not name or info["type"] != "file" or name.endswith("/"):
            return None
        mark = info.get("ETag") or info.get("etag") or info.get("mtime") or info.get("updated") or ""
        return Held(name=name, size_bytes=int(info["size"]), mark=str(mark))


def _put_locally(path: Path, source: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    with replacing(path, StoreError) as part:
        with source.open("rb") as read, part.open("wb") as written:
            while block := read.read(1 << 20):
                written.write(block)
            written.flush()
            os.fsync(written.fileno())
        part.replace(path)


def _patiently(verb: str, what: str, action: Callable[[], _Answer]) -> _Answer:
    """Return what an action returns, which may fail several times; raises StoreError."""
    for number in range(ATTEMPTS):
        try:
            return action()
        except (*_FINAL, StoreError) as exc:
            raise StoreError(f"cannot {verb} {what}: {exc}") from exc
        except Exception as exc:  # each library of a store has errors of its own, without a common root
            if number == ATTEMPTS - 1:
                raise StoreError(f"cannot {verb} {what}: {exc or type(exc).__name__}") from exc
            _LOG.info("cannot %s %s, again: %s", verb, what, exc)
            time.sleep(FIRST_PAUSE_S * 2**number * random.uniform(0.5, 1.0))  # noqa: S311 - no secret
    raise StoreError(f"cannot {verb} {what}")
