"""Nested tables, as TOML yields them, into checked records; shared by everything that loads parameters."""

import errno
import os
import tomllib
from collections.abc import Collection, Mapping
from dataclasses import MISSING, fields, is_dataclass
from enum import StrEnum
from functools import cache
from pathlib import Path
from types import NoneType, UnionType
from typing import Any, ClassVar, Final, TypeVar, cast, get_args, get_origin, get_type_hints

import msgspec

from clutch_model.errors import CalibrationError

RecordT = TypeVar("RecordT")
_MAX_TABLE_BYTES: Final = 4 * 2**20  # far above any settings file, calibration, profile or scenario
_WORDS: Final[Mapping[object, str]] = {
    float: "a number",
    int: "a whole number",
    bool: "true or false",
    str: "a string",
    Mapping: "a table",
}


def require(condition: bool, message: str) -> None:  # noqa: FBT001 - reads as a sentence at the call
    """Raise `CalibrationError` with ``message`` unless ``condition`` holds."""
    if not condition:
        raise CalibrationError(message)


def read_toml_file(path: Path) -> dict[str, Any]:
    """Return the table of a plain file; raise OSError, ``strerror`` in words, or ValueError if it is no TOML."""
    if path.exists() and not (path.is_file() or path.is_dir() or path.samefile(os.devnull)):  # it would be waited for
        raise OSError(errno.EINVAL, "it is a pipe, a socket or a device, not a plain file", str(path))
    with path.open("rb") as file:
        content = file.read(_MAX_TABLE_BYTES + 1)
    if len(content) > _MAX_TABLE_BYTES:
        raise OSError(errno.EFBIG, f"it is too large (more than {_MAX_TABLE_BYTES / 2**20:g} MiB)", str(path))
    try:
        return tomllib.loads(content.decode("utf-8"))
    except RecursionError:
        raise ValueError("its lists or tables are nested too deeply") from None


def read_table(path: Path, what: str, error: type[Exception] = CalibrationError) -> dict[str, Any]:
    """Return the table of a TOML file; raise ``error``, which names ``what`` it is to be, if it cannot be read."""
    try:
        return read_toml_file(path)
    except OSError as exc:
        raise error(f"cannot read {what} {path}: {exc.strerror or exc}") from exc
    except ValueError as exc:
        raise error(f"{what} {path} is not TOML: {exc}") from exc


def record_from(
    kind: type[RecordT], table: object, prefix: str = "", *, error: type[Exception] = CalibrationError, **given: object
) -> RecordT:
    """Return a record, a dataclass or a named tuple, whose members have the names of a table's keys.

    Numbers of a dataclass stay as they were written, whole ones too; those of a named tuple, which compiled code
    takes, become floats.

    Parameters
    ----------
    prefix
        Of every key in a message, such as ``viscosity.``.
    error
        What is raised if the table does not fit, and what the record raises if a value is out of its range.
    given
        Members that do not come from the table.

    Raises
    ------
    CalibrationError
        Or ``error``: naming the first key that is unknown, missing, mistyped or out of range.
    """
    if not isinstance(table, Mapping):
        raise error(f"{prefix.rstrip('. :')} must be a table, got {table!r}".lstrip())
    hints, optional = _known(cast("Any", kind))
    members = {name: hint for name, hint in hints.items() if name not in given}
    for key in sorted(set(table) - set(members)):
        raise error(f"{prefix}{key} is unknown; known: {', '.join(sorted(members))}")
    for key in [one for one in members if one not in table and one not in optional]:
        raise error(f"{prefix}{key} is missing")
    values = {key: _member(members[key], value, f"{prefix}{key}", error) for key, value in table.items()}
    if not is_dataclass(kind):
        values = {key: float(value) if members[key] is float else value for key, value in values.items()}
    try:
        return kind(**values, **given)
    except error as exc:
        raise error(f"{prefix}{exc}") from exc


@cache
def _known(kind: Any) -> tuple[dict[str, Any], Collection[str]]:  # noqa: ANN401 - a class of records
    """Return the annotations of the members of a record, and which of them have a value of their own."""
    hints = {name: hint for name, hint in get_type_hints(kind).items() if get_origin(hint) is not ClassVar}
    if not is_dataclass(kind):
        return hints, kind._field_defaults.keys() if hasattr(kind, "_field_defaults") else ()
    return hints, [member.name for member in fields(kind) if not member.default is member.default_factory is MISSING]


def _member(hint: Any, value: object, where: str, error: type[Exception]) -> Any:  # noqa: ANN401 - as annotated
    """Return the value of one member as its annotation wants it; a record, or a table of them, may be there already."""
    if get_origin(hint) is UnionType:  # a file has no null: what is optional is there or not
        (hint,) = (kind for kind in get_args(hint) if kind is not NoneType)
    if isinstance(hint, type) and (is_dataclass(hint) or hasattr(hint, "_fields")):
        record = cast("type[object]", hint)
        return value if isinstance(value, record) else record_from(record, value, f"{where}.", error=error)
    if get_origin(hint) is tuple and is_dataclass(get_args(hint)[0]):
        kind = get_args(hint)[0]
        if not isinstance(value, list) or not all(isinstance(table, Mapping) for table in value):
            raise error(f"{where} must be an array of tables, got {value!r}")
        return tuple(record_from(kind, table, f"{where} {row}: ", error=error) for row, table in enumerate(value, 1))
    try:
        converted = msgspec.convert(value, hint)
    except msgspec.ValidationError as exc:
        raise error(f"{where} must be {_word(hint)}, got {value!r}") from exc
    return value if hint is float else converted


def _word(hint: Any) -> str:  # noqa: ANN401 - an annotation
    """Return what an annotation wants, for people."""
    if isinstance(hint, type) and issubclass(hint, StrEnum):
        return f"one of {', '.join(hint)}"
    if get_origin(hint) is tuple:
        inner, *others = get_args(hint)
        count = "" if others == [...] else f"{1 + len(others)} "
        return f"a list of {count}{_word(inner).removeprefix('a ')}s"
    return _WORDS.get(get_origin(hint) or hint, "something else")
