"""Libraries that only an extra brings, and the words that say how to install one."""

from importlib import import_module
from importlib.metadata import packages_distributions
from typing import Any

from canlog.errors import ExtraMissingError

_OWN_NAME = "canlog"


def load_extra(module: str, what: str, extra: str = "") -> Any:  # noqa: ANN401 - a module of any library
    """Return a module of an optional library.

    Parameters
    ----------
    module : str
        Its name.
    what : str
        Who needs it, for people: ``Parquet needs pyarrow``.
    extra : str
        Which extra brings it; empty: it is installed by its own name.

    Raises
    ------
    ExtraMissingError
        If it is not installed.
    """
    try:
        return import_module(module)
    except ImportError as exc:
        raise extra_missing(what, extra) if extra else ExtraMissingError(f"{what}: pip install {module}") from exc


def extra_missing(what: str, extra: str) -> ExtraMissingError:
    """Return the error that says what to install: an extra of the distribution that this package came with."""
    distributions = packages_distributions().get(_OWN_NAME, [_OWN_NAME])
    return ExtraMissingError(f"{what}: pip install '{distributions[0]}[{extra}]'")
