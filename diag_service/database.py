"""Databases of other people: read with the care that foreign files need."""

import logging
import re
from pathlib import Path
from typing import Final

import cantools
from cantools.database.can import Database

from diag_service.errors import ConfigError

MAX_FILE_BYTES: Final = 32 * 2**20  # the largest public databases have about 5 MB
MAX_MESSAGE_BYTES: Final = 1785  # longest J1939 transport message, far above any CAN frame
MAX_MULTIPLEX_RANGE: Final = 65_536  # the parser writes every value of a multiplexer range out
MAX_DIGITS: Final = 9  # no number that sizes something needs more

_LOG: Final = logging.getLogger(__name__)
_STRING: Final = re.compile(r'"(?:[^"\\]|\\.)*"', re.DOTALL)
_MESSAGE: Final = re.compile(r"\bBO_\s+\d+\s+\w+\s*:\s*(\d+)")
_SIGNAL_PLACE: Final = re.compile(r"(\d+)\s*\|\s*(\d+)\s*@")
_MULTIPLEX_VALUES: Final = re.compile(r"\bSG_MUL_VAL_\s[^;]*;")
_RANGE: Final = re.compile(r"(\d+)\s*-\s*(\d+)")


def load_database(path: Path) -> Database:
    """Return the messages of a DBC file.

    A file that breaks the strict rules (overlapping signals, signals outside their message) is loaded without them,
    and a warning is logged; whether the signals in use are sound is checked when they are mapped.

    Raises
    ------
    ConfigError
        If the file is missing, unreadable, not a DBC, has no messages, or names sizes that no CAN message has.
    """
    text = _read_text(path)
    _refuse_absurd_sizes(text, path)
    try:
        database = _parse(text, strict=True)
    except cantools.Error as strict_error:
        database = _parse_leniently(text, path, strict_error)
    if not database.messages:
        raise ConfigError(f"{path} is not a DBC file, or it has no messages")
    return database


def _read_text(path: Path) -> str:
    """Return the text of the file; DBC files come in UTF-8 and in the Windows code page."""
    try:
        if path.stat().st_size > MAX_FILE_BYTES:
            raise ConfigError(f"{path} is too large for a DBC file (more than {MAX_FILE_BYTES // 2**20} MiB)")
        content = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"cannot read the DBC file {path}: {error.strerror or error}") from error
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError:
        return content.decode("cp1252", errors="replace")


def _refuse_absurd_sizes(text: str, path: Path) -> None:
    """Raise ConfigError for sizes that would make the parser fill the memory, before it sees them."""
    bare = _STRING.sub('""', text)
    for (size,) in ((match.group(1),) for match in _MESSAGE.finditer(bare)):
        if _number(size) > MAX_MESSAGE_BYTES:
            raise ConfigError(f"{path}: a message of {_shown(size)} bytes is not a CAN message")
    for start, length in _SIGNAL_PLACE.findall(bare):
        if _number(start) + _number(length) > 8 * MAX_MESSAGE_BYTES:
            raise ConfigError(f"{path}: a signal at {_shown(start)}|{_shown(length)} lies outside any CAN message")
    for statement in _MULTIPLEX_VALUES.findall(bare):
        for first, last in _RANGE.findall(statement):
            if _number(last) - _number(first) >= MAX_MULTIPLEX_RANGE:
                raise ConfigError(f"{path}: the multiplexer range {_shown(first)}-{_shown(last)} is too wide")


def _number(digits: str) -> int:
    """Return a decimal number, or a billion if it has more digits than any size needs."""
    return int(digits) if len(digits) <= MAX_DIGITS else 10**MAX_DIGITS


def _shown(digits: str) -> str:
    """Return a number short enough for one line."""
    return digits if len(digits) <= 20 else f"{digits[:17]}..."


def _parse(text: str, *, strict: bool) -> Database:
    """Return what cantools makes of the text."""
    database = cantools.database.load_string(text, database_format="dbc", strict=strict)
    if not isinstance(database, Database):
        raise TypeError("not a CAN database")
    return database


def _parse_leniently(text: str, path: Path, strict_error: Exception) -> Database:
    """Return the database without strict checks; tell the user what they found."""
    try:
        database = _parse(text, strict=False)
    except cantools.Error as error:
        raise ConfigError(f"{path} is not a DBC file: {_one_line(error)}") from error
    _LOG.warning("%s does not load strictly (%s); loaded without strict checks", path, _one_line(strict_error))
    return database


def _one_line(error: Exception) -> str:
    """Return the text of a foreign error, on one line of bearable length."""
    cause = error.__cause__ or error
    text = " ".join(str(cause).split()) or type(cause).__name__
    return text if len(text) <= 160 else f"{text[:157]}..."
