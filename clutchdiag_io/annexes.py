"""What attaches to a program from outside: what entry points of its groups name. No program imports its annex."""

from functools import cache
from importlib.metadata import EntryPoint, entry_points
from typing import Any


@cache
def _found(group: str) -> dict[str, EntryPoint]:
    return {one.name: one for one in sorted(entry_points(group=group), key=lambda one: one.name)}


def attached(group: str) -> list[Any]:
    """Return all that attaches to a group, in order of name."""
    return [one.load() for one in _found(group).values()]


def is_attached(group: str, name: str) -> bool:
    """Return whether something attaches to a group by this name."""
    return name in _found(group)


def part(group: str, name: str) -> Any:  # noqa: ANN401 - whatever is attached there
    """Return what attaches to a group by this name; raises LookupError if nothing does."""
    if not is_attached(group, name):
        raise LookupError(f"no installed package provides {name} for {group}: install clutchdiag anew")
    return _found(group)[name].load()
