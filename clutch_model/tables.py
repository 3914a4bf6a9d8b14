"""Nested tables, as TOML yields them, into checked records; shared by everything that loads parameters."""

import math
from collections.abc import Iterable, Mapping

from clutch_model.errors import CalibrationError


def require(condition: bool, message: str) -> None:  # noqa: FBT001 - reads as a sentence at the call
    """Raise `CalibrationError` with ``message`` unless ``condition`` holds."""
    if not condition:
        raise CalibrationError(message)


def check_keys(where: str, given: Iterable[str], known: Iterable[str]) -> None:
    """Raise `CalibrationError` if a key is unknown or missing."""
    unknown, missing = sorted(set(given) - set(known)), sorted(set(known) - set(given))
    require(not unknown, f"{where}: unknown key {unknown}")
    require(not missing, f"{where}: missing key {missing}")


def number(value: object, where: str) -> float:
    """Return a finite number of a table.

    Raises
    ------
    CalibrationError
        If it is something else.
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise CalibrationError(f"{where} must be a number, got {value!r}")
    require(math.isfinite(value), f"{where} must be finite, got {value}")
    return float(value)


def numbers(value: object, where: str, count: int) -> tuple[float, ...]:
    """Return a list of ``count`` finite numbers of a table.

    Raises
    ------
    CalibrationError
        If it is something else.
    """
    if not isinstance(value, list | tuple) or len(value) != count:
        raise CalibrationError(f"{where} must be a list of {count} numbers, got {value!r}")
    return tuple(number(entry, where) for entry in value)


def subtable(value: object, where: str) -> Mapping[str, object]:
    """Return a nested table.

    Raises
    ------
    CalibrationError
        If it is something else.
    """
    if not isinstance(value, Mapping):
        raise CalibrationError(f"{where} must be a table")
    return value
