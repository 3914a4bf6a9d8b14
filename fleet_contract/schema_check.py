"""JSON Schemas compiled for thousands of messages a second, and their refusals in words.

The schemas stay the only description; jsonschema-rs holds records against them. Stricter in two points, both because of
what reads the record next: an integer is written without a fraction, ``1.0`` is none; and a moment is one that Python
knows, without leap seconds, of these centuries.
"""

import json
import re
from collections.abc import Callable, Iterable, Mapping
from datetime import datetime
from functools import cache
from itertools import islice
from pathlib import Path
from typing import Final

from jsonschema_rs import Draft202012Validator, ValidationError

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
    """A keyword that refuses ``1.0`` where an integer belongs: JSON Schema accepts it."""

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
    mistakes = [_in_place(error) for error in islice(errors, _MOST_SAID + 1)]
    return "; ".join(mistakes if len(mistakes) <= _MOST_SAID else [*mistakes[:_MOST_SAID], "and more"])


def _in_place(error: ValidationError) -> str:
    """Return place and cause of a mistake, with the beginning of a value that is wrong by itself."""
    place = "".join(f"{shown(str(step))}: " for step in error.instance_path)
    is_quoting = len(error.message) > _LONGEST_MESSAGE or not error.message.isprintable()  # names of a stranger's
    message = f"{_VALUE} breaks the schema's rule {error.kind.name}" if is_quoting else error.message
    is_plain = not isinstance(error.instance, dict | list)
    return f"{place}{message}{f', got {shown(repr(error.instance))}' if is_plain else ''}"


SCHEMA_FOLDER: Final = Path(__file__).with_name("schemas")
ENVELOPE: Final = "event"
# What a number of a message can be, by the unit in which the name of its field ends. The bounds are generous, for a
# number that is merely strange is worth keeping; sums, squares and differences within them fit a database.
MOST_MU: Final = 1e4  # friction coefficients are below 1; a fit that knows little finds some hundred
_FAR: Final = 1e19  # of a number that has a name of its sender's alone: any of 64 bits; nothing is summed

# The end of a name, least, most; the first that fits counts.
_BY_NAME: Final = tuple(
    (re.compile(f"(?:{end})$"), least, most)
    for end, least, most in (
        (r"(?:^|_)mu(?:_[cs])?", -MOST_MU, MOST_MU),  # and its standard deviations and changes
        ("_bus_ns", -(4 * 10**18), 4 * 10**18),  # [ns] 1843 to 2096: a difference has 64 bits
        ("_count|^number|^blocks_as_one", 0, 10**9),  # a gear change each second for 30 years
        ("_gear", 0, 100),  # trucks have 18
        ("_m_s2|_m_s3", -1e6, 1e6),  # acceleration and jerk of a car: a crash has 1e3 m/s2 and 1e5 m/s3
        ("_rad_s2|_rad_s|_rad|_hz", -1e7, 1e7),  # 1e5 rad/s burst any gearbox; 1e4 rad/s within 1 ms; 1e3 rad/s for 1 h
        ("_s_rad", -1e7, 1e7),  # a slope: the whole friction within 1e-7 rad/s
        ("_s", -1e9, 1e9),  # 30 years
        ("_k", 0, 1e4),  # no metal is solid or liquid at 10,000 K
        ("_j", -1e9, 1e9),  # a truck of 40 t at 100 km/h has 1.5e7 J
        ("_pa", -1e9, 1e9),  # 10,000 bar; a transmission has 30
        ("_nm", -1e6, 1e6),  # the largest diesel engine of a truck gives 4e3 N m
        ("_m", 0, 1e10),  # 10 million km
        (
            "_ratio|ratio_before|ratio_after|^change|^std|^expected",
            -1e9,
            1e9,
        ),  # of any unit: a change of pressure [Pa] is largest
        ("", -_FAR, _FAR),
    )
)


def schema(name: str) -> JsonObject:
    """Return the JSON Schema of a channel's data by its label, or of the envelope, with the bounds of its numbers."""
    table: JsonObject = json.loads((SCHEMA_FOLDER / f"{name}-v1.json").read_text(encoding="utf-8"))
    return {key: bounded(value, key) for key, value in table.items()}


def bounded(part: object, name: str = "") -> object:
    """Return a part of a JSON Schema in which each number has bounds: its own, or those by its name if narrower."""
    if isinstance(part, list):
        return [bounded(item, name) for item in part]
    if not isinstance(part, dict):
        return part
    made = {key: bounded(value, name if key == "items" else key) for key, value in part.items()}
    kinds = part.get("type")
    if "number" not in (kinds := kinds if isinstance(kinds, list) else [kinds]) and "integer" not in kinds:
        return made
    least, most = next((least, most) for end, least, most in _BY_NAME if end.search(name))
    return made | {"minimum": max(least, part.get("minimum", least)), "maximum": min(most, part.get("maximum", most))}


def check_data(channel: Channel, data: JsonObject) -> None:
    """Raise SchemaError if a record is not what its channel carries."""
    _check_of(channel.label)(data)


def check_envelope(event: JsonObject) -> None:
    """Raise SchemaError if a message is no CloudEvent of this contract."""
    _check_of(ENVELOPE)(event)


@cache
def _check_of(name: str) -> Callable[[object], None]:
    return compile_schema(schema(name))
