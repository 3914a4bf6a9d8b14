"""What stops a demonstration, a missing library before it begins."""

from importlib.util import find_spec
from typing import Final

EXTRA_OF: Final = {
    **dict.fromkeys(("amqtt", "matplotlib", "doipclient", "isotp", "udsoncan"), "demo"),
    **dict.fromkeys(("alembic", "psycopg", "sqlalchemy"), "fleet"),
    **dict.fromkeys(("starlette", "uvicorn"), "page"),
}


class DemoError(Exception):
    """The demonstration cannot go on; the text says why."""


class ExtraMissingError(DemoError):
    """A library that only an extra brings is not installed."""

    def __init__(self, module: str, extra: str) -> None:
        super().__init__(f"the module {module} is not installed: pip install 'clutchdiag[{extra}]'")


def check_extra(extra: str) -> None:
    """Raise ExtraMissingError unless the libraries of an extra can be found."""
    for module, name in EXTRA_OF.items():
        if name == extra and find_spec(module) is None:
            raise ExtraMissingError(module, extra)
