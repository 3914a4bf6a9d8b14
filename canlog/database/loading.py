"""Databases of other people, DBC, KCD, ARXML and SYM: read with the care that foreign files need.

cantools believes every number in a file: 92 bytes of DBC can take 8.7 GB, and nested ranges of multiplexers multiply.
So the text is looked at for sizes that no CAN message has, which gives the best message, then parsed in a process of
its own with little memory and time (database_child.py), which bounds whatever else a file may do and costs a third of
a second, once for each file: what came of it is kept.
"""

import logging
import os
import pickle
import re
import signal
import stat
import subprocess
import sys
from collections.abc import Sequence
from contextlib import suppress
from enum import StrEnum
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Final

import cantools
from cantools.database.can import Database, Message

from canlog.database import database_child
from canlog.database.addressing import J1939, is_of_groups
from canlog.database.database_parsing import Parsed
from canlog.errors import NOTICE, DefinitionError
from canlog.files import read_small_file, replacing

MAX_FILE_BYTES: Final = 32 * 2**20  # the largest public databases have about 5 MB as DBC, some more as ARXML
MAX_MESSAGE_BYTES: Final = 1785  # longest J1939 transport message, far above any CAN frame
MAX_MULTIPLEX_RANGE: Final = 65_536  # the parser writes every value of a multiplexer range out
MAX_DIGITS: Final = 9  # no number that sizes something needs more
PARSER_BYTES: Final = 320 * 2**20  # five megabytes of DBC take 300; the program that waits has 180
PARSER_TIME_S: Final = 8  # and seven seconds of computing; with all that surrounds it, ten at most
MAX_WAIT_S: Final = 60.0  # for the parsing process on a busy machine; its computing time is limited by itself
MAX_WARNINGS: Final = 20
OUT_OF_TIME: Final = frozenset(-number for number in signal.Signals if number.name in {"SIGXCPU", "SIGKILL"})
HEAD_CHARACTERS: Final = 65_536  # a file says what it is in its beginning

_LOG: Final = logging.getLogger(__name__)
# None of these looks at a character more than a few times, whatever the text: possessive, and open ends are ends.
_STRING: Final = re.compile(r'"(?:[^"\\]|\\.)*+(?:"|\Z)', re.DOTALL)
_MESSAGE: Final = re.compile(r"\bBO_\s++\d++\s++\w++\s*+:\s*+(\d++)")
_SIGNAL_PLACE: Final = re.compile(r"(?<!\d)(\d++)\s*+\|\s*+(\d++)\s*+@")
_MULTIPLEX_VALUES: Final = re.compile(r"\bSG_MUL_VAL_\s[^;]*+(?:;|\Z)")
_RANGE: Final = re.compile(r"(?<!\d)(\d++)\s*+-\s*+(\d++)")
_SYM: Final = re.compile(r"((?:\s|//[^\n]*\n)*)FormatVersion\s*=")  # comments may stand before it
_ROOT: Final = re.compile(r"<(?:[\w.-]+:)?([A-Za-z_][\w.-]*)[\s/>]")
_BUS_MARK: Final = "#"
_MORE: Final = " (--parser-time gives more)"
_NARROW_BYTES: Final = 64  # that tell whether a text without a mark has two bytes for each letter
_BYTE_ORDER_MARKS: Final = (b"\xff\xfe", b"\xfe\xff")  # of UTF-16


class DatabaseFormat(StrEnum):
    """The formats that can be read, as cantools names them."""

    DBC = "dbc"
    KCD = "kcd"
    ARXML = "arxml"
    SYM = "sym"

    @property
    def in_words(self) -> str:
        return f"{'an' if self is DatabaseFormat.ARXML else 'a'} {self.name} file"


_FORMAT_OF_ROOT: Final = {"NetworkDefinition": DatabaseFormat.KCD, "AUTOSAR": DatabaseFormat.ARXML}


def load_database(
    path: Path | str, *, is_lenient: bool = False, is_j1939: bool = False, parser_time_s: int = PARSER_TIME_S
) -> Database:
    """Return the messages of a DBC, KCD, ARXML or SYM file; which one it is, its contents say.

    Signals that overlap or lie outside their message are warned of, message by message; whether the signals in use
    are sound is checked when they are mapped.

    Parameters
    ----------
    path : Path or str
        The file; of a network of several buses, ``FILE#BUS`` is one of them.
    is_lenient : bool
        Leave items out of a DBC file that cannot be right, with a warning of each, instead of refusing the file.
    is_j1939 : bool
        Match all 29-bit identifiers by their parameter group (J1939, NMEA 2000), whatever the database says. Without,
        that is done if it says nothing and the sender of all of them is the null address, which no sender has.
    parser_time_s : int
        How much processor time [s] the parsing may take; beyond the usual 8 s, memory as many times as much.

    Raises
    ------
    DefinitionError
        If the file is missing, unreadable, of another format, has no messages, names sizes that no CAN message has,
        takes too much memory or time to parse, or has items that cannot be right.
    """
    if parser_time_s < 1:
        raise DefinitionError(f"a database needs at least 1 s to be read, got {parser_time_s} s")
    file, bus = bus_of(Path(path))
    text = _read_text(file)
    database_format = _format_of(text, file)
    if database_format == DatabaseFormat.DBC:
        _refuse_absurd_sizes(text, file)
    elif begin := _SYM.match(text):
        text = "\n" * begin[1].count("\n") + text[begin.end(1) :]  # cantools takes no such comments
    parsed = _parse(text, database_format, file, is_lenient=is_lenient, parser_time_s=parser_time_s)
    if parsed.database is None:
        more = f"; {parsed.offence_count - 1} more like this" if parsed.offence_count > 1 else ""
        hint = "(--lenient leaves out what cannot be right)"
        raise DefinitionError(f"{file} does not load strictly: {parsed.offences[0]}{more} {hint}")
    if not parsed.database.messages:
        raise DefinitionError(f"{file} is not {database_format.in_words}, or it has no messages")
    offences = [f"{one}{'' if one.is_mended else ' (left out)'}" for one in parsed.offences]
    _warn_each(file, offences, parsed.offence_count)
    complaints = [f"does not load strictly: {complaint}" for complaint in parsed.complaints]
    _warn_each(file, complaints, len(complaints))
    chosen = _chosen_messages(parsed.database, bus, file, is_lenient=is_lenient)
    long = [message for message in chosen.messages if message.is_extended_frame]
    protocol = chosen.dbc.attributes.get("ProtocolType") if chosen.dbc else None
    if not is_j1939 and is_of_groups(long, str(protocol.value) if protocol else ""):
        _LOG.log(
            NOTICE, "%s: %d messages are matched by their parameter groups (PGN), as J1939 has it", file, len(long)
        )
        is_j1939 = True
    for message in long if is_j1939 else ():
        message.protocol = J1939
    return chosen


def _warn_each(path: Path, said: Sequence[str], count: int) -> None:
    """Warn of the first of many things, and say how many more there are."""
    for text in said[:MAX_WARNINGS]:
        _LOG.warning("%s: %s", path, text)
    if count > MAX_WARNINGS:
        _LOG.warning("%s: and %d more like these", path, count - MAX_WARNINGS)


def _read_text(path: Path) -> str:
    """Return the text of the file; DBC files come in UTF-8 and in the Windows code page."""
    try:
        content = read_small_file(path, MAX_FILE_BYTES)
    except OSError as error:
        raise DefinitionError(f"cannot read the database {path}: {error.strerror or error}") from error
    text = _decoded(content).rstrip("\x00\x1a")  # how files of old ended
    return text.replace("\r\n", "\n").replace("\r", "\n") + "\n"


def _decoded(content: bytes) -> str:
    if content.startswith(_BYTE_ORDER_MARKS):
        return content.decode("utf-16", errors="replace")
    if content[:_NARROW_BYTES].count(0) * 3 > len(content[:_NARROW_BYTES]):  # every other byte, as a rule
        return content.decode("utf-16-le" if content[1:2] == b"\0" else "utf-16-be", errors="replace")
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252", errors="replace")


def _format_of(text: str, path: Path) -> DatabaseFormat:
    """Return the format of a text; whatever is nothing else is taken for a DBC file."""
    head = text[:HEAD_CHARACTERS].lstrip()
    if _SYM.match(text):
        return DatabaseFormat.SYM
    if not head.startswith("<"):
        return DatabaseFormat.DBC
    root = _ROOT.search(head)
    if root is None or root[1] not in _FORMAT_OF_ROOT:
        raise DefinitionError(f"{path} is neither a DBC file nor a KCD or ARXML file")
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise DefinitionError(f"{path} defines a document type or entities, which no {root[1]} file needs")
    return _FORMAT_OF_ROOT[root[1]]


def _refuse_absurd_sizes(text: str, path: Path) -> None:
    """Raise DefinitionError for sizes that would make the parser fill the memory, before it sees them."""
    bare = _STRING.sub('""', text)
    for (size,) in ((match.group(1),) for match in _MESSAGE.finditer(bare)):
        if _number(size) > MAX_MESSAGE_BYTES:
            raise DefinitionError(f"{path}: a message of {_shown(size)} bytes is not a CAN message")
    for start, length in _SIGNAL_PLACE.findall(bare):
        if _number(start) + _number(length) > 8 * MAX_MESSAGE_BYTES:
            raise DefinitionError(f"{path}: a signal at {_shown(start)}|{_shown(length)} lies outside any CAN message")
    for statement in _MULTIPLEX_VALUES.findall(bare):
        for first, last in _RANGE.findall(statement):
            if _number(last) - _number(first) >= MAX_MULTIPLEX_RANGE:
                raise DefinitionError(f"{path}: the multiplexer range {_shown(first)}-{_shown(last)} is too wide")


def _number(digits: str) -> int:
    """Return a decimal number, or a billion if it has more digits than any size needs."""
    return int(digits) if len(digits) <= MAX_DIGITS else 10**MAX_DIGITS


def _shown(digits: str) -> str:
    """Return a number short enough for one line."""
    return digits if len(digits) <= 20 else f"{digits[:17]}..."


def _parse(text: str, database_format: DatabaseFormat, path: Path, *, is_lenient: bool, parser_time_s: int) -> Parsed:
    """Return what cantools makes of the text, and what is wrong with it."""
    mode = database_child.LENIENT if is_lenient else database_child.STRICT
    key = key_of(text, database_format, mode)
    written = kept(key)
    if written is None:
        written = _written_by_child(text, database_format, path, mode, parser_time_s)
        keep(key, written)
    parsed: Parsed = pickle.loads(written)  # noqa: S301 - written by our own module, and kept where only we write
    return parsed


def _written_by_child(text: str, database_format: DatabaseFormat, path: Path, mode: str, parser_time_s: int) -> bytes:
    """Return the pickle of what came of the text in a process of its own."""
    most_bytes = PARSER_BYTES * max(parser_time_s, PARSER_TIME_S) // PARSER_TIME_S
    words = (database_format, str(most_bytes), str(parser_time_s), mode)
    command = [sys.executable, "-P", "-m", database_child.__name__, *words]
    folders = os.pathsep.join(folder for folder in sys.path if folder)
    try:
        done = subprocess.run(  # noqa: S603 - this interpreter, a module of ours
            command,
            input=text.encode(errors="replace"),
            capture_output=True,
            check=False,
            timeout=MAX_WAIT_S + parser_time_s,
            env={**os.environ, "PYTHONPATH": folders},
        )
    except subprocess.TimeoutExpired as error:
        raise DefinitionError(f"{path} was not parsed within {MAX_WAIT_S + parser_time_s:.0f} s") from error
    except OSError as error:
        raise DefinitionError(f"cannot start the process that parses {path}: {error.strerror or error}") from error
    if done.returncode == database_child.OUT_OF_MEMORY or b"MemoryError" in done.stderr:
        raise DefinitionError(f"{path} takes more than {most_bytes // 2**20} MiB of memory to parse{_MORE}")
    if done.returncode in OUT_OF_TIME:
        raise DefinitionError(f"{path} takes more than {parser_time_s} s to parse{_MORE}")
    if done.returncode != 0:
        lines = done.stderr.decode(errors="replace").strip().splitlines() or ["the parser ended without a result"]
        raise DefinitionError(f"{path} is not {database_format.in_words}: {lines[-1][:200]}")
    return done.stdout


def bus_of(path: Path) -> tuple[Path, str]:
    """Return the file and the bus that ``FILE#BUS`` names; without a bus, or if there is such a file, no bus."""
    name, mark, bus = path.name.rpartition(_BUS_MARK)
    if not mark or not name or path.exists():
        return path, ""
    return path.with_name(name), bus


def _chosen_messages(database: Database, bus: str, path: Path, *, is_lenient: bool) -> Database:
    """Return a database with the messages of a bus, or of all; if lenient, without those of an identifier seen before.

    Raises DefinitionError if there is no such bus, or two buses use one identifier and none of them was named.
    """
    buses = list(dict.fromkeys(message.bus_name for message in database.messages if message.bus_name))
    if bus and bus not in buses:
        raise DefinitionError(f"{path} has no bus {bus!r}; it has {', '.join(buses) or 'none by name'}")
    wanted = [message for message in database.messages if not bus or message.bus_name == bus]
    first: dict[tuple[int, bool], Message] = {}
    kept: list[Message] = []
    for message in wanted:
        other = first.setdefault((message.frame_id, message.is_extended_frame), message)
        if other is not message:
            places = (f"{one.name} of {one.bus_name}" if one.bus_name else one.name for one in (other, message))
            said = f"the identifier {message.frame_id:#x} belongs to {' and to '.join(places)}"
            if other.bus_name != message.bus_name:
                raise DefinitionError(f"{path}: {said}; name one of them: {path}{_BUS_MARK}{message.bus_name}")
            _LOG.warning("%s: %s%s", path, said, " (left out)" if is_lenient else "")
        if other is message or not is_lenient:
            kept.append(message)
    if len(kept) == len(database.messages):
        return database
    return Database(
        messages=kept, nodes=database.nodes, buses=database.buses, version=database.version,
        dbc_specifics=database.dbc, strict=False,
    )  # fmt: skip


def database_of(database: Database | Path | str, *, is_lenient: bool) -> Database:
    """Return a database, loaded if it is a file's name; raises as ``load_database``."""
    return database if isinstance(database, Database) else load_database(Path(database), is_lenient=is_lenient)


# Kept are the pickles of `database_child`, in a folder that nobody else can write to, as machine code of kernels is.
MOST_KEPT: Final = 32
MOST_BYTES: Final = 16 * 2**20  # of one; the largest public databases come to some more
_DIGEST_BYTES: Final = 32
_OTHERS_WRITE: Final = stat.S_IWGRP | stat.S_IWOTH


def key_of(text: str, database_format: str, mode: str) -> str:
    """Return what a parsed text is known by: the text, how it is parsed, and all that parses it."""
    digest = sha256(f"{_maker()}\0{database_format}\0{mode}\0".encode())
    digest.update(text.encode(errors="replace"))
    return digest.hexdigest()


def kept(key: str) -> bytes | None:
    """Return what was kept under a key, None if nothing was or if it cannot be trusted."""
    folder = _folder()
    if folder is None:
        return None
    try:
        content = (folder / key).read_bytes()
        if sha256(content[_DIGEST_BYTES:]).digest() != content[:_DIGEST_BYTES]:
            return None
        os.utime(folder / key)  # the oldest are forgotten first
    except OSError:
        return None
    return content[_DIGEST_BYTES:]


def keep(key: str, content: bytes) -> None:
    """Keep what came of a text; where that is not possible, the next start parses it again."""
    folder = _folder()
    if folder is None or len(content) > MOST_BYTES:
        return
    with suppress(OSError), replacing(folder / key, OSError) as part:
        part.write_bytes(sha256(content).digest() + content)
        part.replace(folder / key)
        newest_first = sorted(folder.iterdir(), key=lambda path: -path.stat().st_mtime_ns)
        for path in newest_first[MOST_KEPT:]:
            path.unlink(missing_ok=True)


def _folder() -> Path | None:
    """Return the folder, made if need be; None where there is none that is this user's alone."""
    if not hasattr(os, "geteuid"):
        return None
    try:
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "clutchdiag" / "databases"
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        found = folder.lstat()
    except (OSError, RuntimeError):  # no home, no rights, something else in the way
        return None
    is_own = stat.S_ISDIR(found.st_mode) and found.st_uid == os.geteuid() and not found.st_mode & _OTHERS_WRITE
    return folder if is_own else None


@cache
def _maker() -> str:
    """Return what parses: our modules, cantools, Python."""
    digest = sha256()
    for module in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(module.read_bytes())
    return f"{digest.hexdigest()} {cantools.__version__} {sys.version}"
