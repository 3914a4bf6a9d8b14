"""Names of files as text: a name may hold bytes that are no text, which neither JSON nor Parquet can carry."""

from collections.abc import Mapping


def legible(text: str) -> str:
    r"""Return a text with its undecodable bytes as escapes, such as ``log\xe9.log``."""
    try:
        return text.encode(errors="surrogateescape").decode(errors="backslashreplace")
    except UnicodeEncodeError:  # a lone surrogate that stands for no byte
        return text.encode(errors="backslashreplace").decode()


def legible_record(value: object) -> object:
    """Return a record of mappings and lists in which every text is legible."""
    if isinstance(value, str):
        return legible(value)
    if isinstance(value, Mapping):
        return {legible_record(key): legible_record(one) for key, one in value.items()}
    if isinstance(value, list | tuple):
        return [legible_record(one) for one in value]
    return value
