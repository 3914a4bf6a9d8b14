"""JSON Schemas compiled for thousands of messages a second, and their refusals in words.

The schemas stay the only description; jsonschema-rs holds records against them. Stricter in two points, both because of
what reads the record next: an integer is written without a fraction, ``1.0`` is none; and a moment is one that Python
knows, without leap seconds, of these centuries.
"""

import json
from collections.abc import Callable, Iterable, Mapping
from datetime import datetime
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Final

from jsonschema_rs import Draft202012Validator, ValidationError

from fleet_contract.bounds import bounded
from fleet_contract.errors import SchemaError
from fleet_contract.strict_json import JsonObject, shown
from fleet_contract.topics import Channel

Check = Callable[[object], None]

_WHOLE: Final = "x-written-without-fraction"  # beside what must be an integer, in the schemas as they are compiled
_VALUE: Final = "the value"  # stands in messages for what may be long and is a stranger's
_LONGEST_MESSAGE: Final = 1_000  # characters; that of our longest enumeration has 400
_FIRST_YEAR, _LAST_YEAR = 1900, 2199  # of moments: months are counted on from each, and back
_MOST_SAID: Final = 3  # mistakes of one record


def compile_schema(schema: Mapping[str, object]) -> Check:
    """Return a function that raises SchemaError for a value which the schema does not describe.

    Raises SchemaError if the schema is none, refers to nothing or names a format that is not known.
    """
    try:
        validator = Draft202012Validator(
            _with_whole_numbers(schema),
            formats={"date-time": _is_moment},
            validate_formats=True,
            ignore_unknown_formats=False,
            mask=_VALUE,
            keywords={_WHOLE: _WholeNumber},
            offline=True,
        )
    except ValueError as exc:
        raise SchemaError(f"no schema: {shown(str(exc))}") from exc

    def check(value: object) -> None:
        if not validator.is_valid(value):
            raise SchemaError(_in_words(validator.iter_errors(value)))

    return check


class _WholeNumber:
    """What refuses ``1.0`` where an integer belongs: JSON Schema takes it for one."""

    def __init__(self, parent_schema: object, value: object, schema_path: object) -> None:
        pass

    def validate(self, instance: object) -> None:
        """Raise ValueError of a number that is written with a fraction."""
        if isinstance(instance, float):
            raise ValueError("an integer is written without a fraction")  # noqa: TRY004 - of the value, not its type


def _with_whole_numbers(schema: Mapping[str, object]) -> dict[str, object]:
    """Return a schema in which integers, and enumerations of them, have the keyword that refuses fractions."""
    copied = {key: _nested(value) for key, value in schema.items()}
    return copied | {_WHOLE: True} if _takes_integers_only(schema) else copied


def _nested(part: object) -> object:
    if isinstance(part, list):
        return [_nested(item) for item in part]
    return _with_whole_numbers(part) if isinstance(part, Mapping) else part


def _takes_integers_only(part: Mapping[str, object]) -> bool:
    kinds, values = part.get("type"), part.get("enum")
    names = kinds if isinstance(kinds, list) else [kinds]
    is_enumeration = isinstance(values, list) and any(type(value) is int for value in values)
    return is_enumeration or ("integer" in names and "number" not in names)


def _is_moment(text: str) -> bool:
    try:
        return _FIRST_YEAR <= datetime.fromisoformat(text).year <= _LAST_YEAR
    except ValueError:
        return False


def _in_words(errors: Iterable[ValidationError]) -> str:
    said = [_told(error) for error in islice(errors, _MOST_SAID + 1)]
    return "; ".join(said if len(said) <= _MOST_SAID else [*said[:_MOST_SAID], "and more"])


def _told(error: ValidationError) -> str:
    """Return place and cause of a mistake, with the beginning of a value that is wrong by itself."""
    place = "".join(f"{shown(str(step))}: " for step in error.instance_path)
    is_quoting = len(error.message) > _LONGEST_MESSAGE or not error.message.isprintable()  # names of a stranger's
    message = f"{_VALUE} breaks the schema's rule {error.kind.name}" if is_quoting else error.message
    is_plain = not isinstance(error.instance, dict | list)
    return f"{place}{message}{f', got {shown(repr(error.instance))}' if is_plain else ''}"


SCHEMA_FOLDER: Final = Path(__file__).with_name("schemas")
ENVELOPE: Final = "event"


def schema(name: str) -> JsonObject:
    """Return the JSON Schema of a channel's data by its label, or of the envelope, with the bounds of its numbers."""
    table: JsonObject = json.loads((SCHEMA_FOLDER / f"{name}-v1.json").read_text(encoding="utf-8"))
    return {key: bounded(value, key) for key, value in table.items()}


def check_data(channel: Channel, data: JsonObject) -> None:
    """Raise SchemaError if a record is not what its channel carries."""
    _check_of(channel.label)(data)


def check_envelope(event: JsonObject) -> None:
    """Raise SchemaError if a message is no CloudEvent of this contract."""
    _check_of(ENVELOPE)(event)


@cache
def _check_of(name: str) -> Callable[[object], None]:
    return compile_schema(schema(name))
