"""JSON Schemas compiled to functions: the part of 2020-12 that this contract's schemas use, fit for thousands a second.

The schemas stay the only description. A test holds this against the ``jsonschema`` library, which is some thirty times
slower. Stricter in one point: an integer is written without a fraction, ``1.0`` is none.
"""

import re
from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from typing import Final

from fleet_contract.errors import SchemaError
from fleet_contract.strict_json import shown

Check = Callable[[object], None]

_ANNOTATIONS: Final = frozenset({"$schema", "$id", "$defs", "title", "description", "properties", "required"})
_TYPES: Final[Mapping[str, tuple[type, ...]]] = {
    "object": (dict,),
    "array": (list,),
    "string": (str,),
    "integer": (int,),
    "number": (int, float),
    "boolean": (bool,),
    "null": (type(None),),
}


def compile_schema(schema: Mapping[str, object]) -> Check:
    """Return a function that raises SchemaError for a value which the schema does not describe.

    Raises
    ------
    SchemaError
        If the schema has a keyword that is not supported; nothing is ignored in silence.
    """
    definitions = schema.get("$defs", {})
    if not isinstance(definitions, Mapping):
        raise SchemaError("$defs must be an object")
    references: dict[str, Check] = {}
    for name, part in definitions.items():  # each may refer to those before it
        references[f"#/$defs/{name}"] = _compile(part, references)
    return _compile(schema, references)


def _compile(schema: object, references: Mapping[str, Check]) -> Check:
    if not isinstance(schema, Mapping):
        raise SchemaError(f"no schema: {shown(str(schema))}")
    if "$ref" in schema:
        reference = str(schema["$ref"])
        if reference not in references:
            raise SchemaError(f"unknown reference {reference}")
        return references[reference]
    unknown = schema.keys() - _MAKERS.keys() - _NESTED.keys() - _ANNOTATIONS
    if unknown:
        raise SchemaError(f"not supported: {', '.join(sorted(unknown))}")
    checks = [make(schema[keyword]) for keyword, make in _MAKERS.items() if keyword in schema]
    checks += [make(schema[keyword], references) for keyword, make in _NESTED.items() if keyword in schema]
    if "properties" in schema:
        checks.append(_properties_check(schema, references))
    return _all(checks)


def _all(checks: Sequence[Check]) -> Check:
    if len(checks) == 1:
        return checks[0]

    def check(value: object) -> None:
        for one in checks:
            one(value)

    return check


def _type_check(argument: object) -> Check:
    names = [argument] if isinstance(argument, str) else argument
    if not isinstance(names, list):
        raise SchemaError("type must be a name or a list")
    allowed = frozenset(kind for name in names for kind in _TYPES[name])  # bool is its own type here, not an int

    def check(value: object) -> None:
        if type(value) not in allowed:
            raise SchemaError(f"must be {' or '.join(names)}, got {shown(repr(value))}")

    return check


def _enum_check(argument: object) -> Check:
    values = argument if isinstance(argument, list) else [argument]
    allowed = frozenset((type(value), value) for value in values)

    def check(value: object) -> None:
        if isinstance(value, dict | list) or (type(value), value) not in allowed:
            raise SchemaError(f"must be one of {values}, got {shown(repr(value))}")

    return check


def _pattern_check(argument: object) -> Check:
    pattern = re.compile(str(argument).removesuffix("$") + r"\Z", re.ASCII)  # Python's $ allows a line end after it

    def check(value: object) -> None:
        if isinstance(value, str) and not pattern.search(value):
            raise SchemaError(f"has another form: {shown(repr(value))}")

    return check


def _format_check(argument: object) -> Check:
    if argument != "date-time":
        raise SchemaError(f"format {argument} is not supported")

    def check(value: object) -> None:
        if isinstance(value, str):
            try:
                datetime.fromisoformat(value)
            except ValueError as exc:
                raise SchemaError(f"is no moment: {shown(repr(value))}") from exc

    return check


def _bound_check(is_inside: Callable[[float, float], bool], words: str) -> Callable[[object], Check]:
    def make(bound: object) -> Check:
        if not isinstance(bound, int | float):
            raise SchemaError(f"no bound: {bound}")

        def check(value: object) -> None:
            if isinstance(value, int | float) and not is_inside(value, bound):
                raise SchemaError(f"must be {words} {bound}, got {value}")

        return check

    return make


def _size_check(kind: type, is_inside: Callable[[int, int], bool], words: str) -> Callable[[object], Check]:
    def make(bound: object) -> Check:
        if not isinstance(bound, int):
            raise SchemaError(f"no bound: {bound}")

        def check(value: object) -> None:
            if isinstance(value, kind) and not is_inside(len(value), bound):  # type: ignore[arg-type]  # str, list, dict
                raise SchemaError(f"must have {words} {bound} parts")

        return check

    return make


def _unique_check(argument: object) -> Check:
    def check(value: object) -> None:
        if argument and isinstance(value, list) and any(item in value[:place] for place, item in enumerate(value)):
            raise SchemaError("holds a value twice")

    return check


def _properties_check(schema: Mapping[str, object], references: Mapping[str, Check]) -> Check:
    properties, required = schema["properties"], schema.get("required", [])
    if not isinstance(properties, Mapping) or not isinstance(required, list):
        raise SchemaError("properties must be an object, required a list")
    checks = tuple((name, _compile(part, references)) for name, part in properties.items())
    needed = frozenset(required)

    def check(value: object) -> None:
        if not isinstance(value, dict):
            return
        if not needed <= value.keys():
            raise SchemaError(f"misses {', '.join(sorted(needed - value.keys()))}")
        name = ""
        try:
            for name, one in checks:
                if name in value:
                    one(value[name])
        except SchemaError as exc:
            raise SchemaError(f"{name}: {exc}") from None

    return check


def _items_check(schema: object, references: Mapping[str, Check]) -> Check:
    one = _compile(schema, references)

    def check(value: object) -> None:
        if isinstance(value, list):
            for item in value:
                one(item)

    return check


def _names_check(schema: object, references: Mapping[str, Check]) -> Check:
    one = _compile(schema, references)

    def check(value: object) -> None:
        for name in value if isinstance(value, dict) else ():
            one(name)

    return check


def _values_check(schema: object, references: Mapping[str, Check]) -> Check:
    """Check every value of an object; only for objects without ``properties``, where no value is exempt."""
    one = _compile(schema, references)

    def check(value: object) -> None:
        for part in value.values() if isinstance(value, dict) else ():
            one(part)

    return check


_MAKERS: Final[Mapping[str, Callable[[object], Check]]] = {
    "type": _type_check,  # first: what comes next may take it for granted
    "const": _enum_check,
    "enum": _enum_check,
    "pattern": _pattern_check,
    "format": _format_check,
    "minimum": _bound_check(lambda value, bound: value >= bound, "at least"),
    "maximum": _bound_check(lambda value, bound: value <= bound, "at most"),
    "minLength": _size_check(str, lambda size, bound: size >= bound, "at least"),
    "maxLength": _size_check(str, lambda size, bound: size <= bound, "at most"),
    "minItems": _size_check(list, lambda size, bound: size >= bound, "at least"),
    "maxItems": _size_check(list, lambda size, bound: size <= bound, "at most"),
    "maxProperties": _size_check(dict, lambda size, bound: size <= bound, "at most"),
    "uniqueItems": _unique_check,
}
_NESTED: Final[Mapping[str, Callable[[object, Mapping[str, Check]], Check]]] = {
    "items": _items_check,
    "propertyNames": _names_check,
    "additionalProperties": _values_check,
}
