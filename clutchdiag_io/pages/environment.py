"""Templates become text: everything in them is escaped, and a name that is not there is an error."""

from typing import Final

from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

from clutchdiag_io.pages.cells import rows_markup

_OWN: Final = "clutchdiag_io.pages"  # brings style.css and parts.html


def templates_of(package: str) -> Environment:
    """Return the templates of a package's folder ``templates``, and behind them those that all pages share."""
    made = Environment(
        loader=ChoiceLoader([PackageLoader(package), PackageLoader(_OWN)]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    made.filters["rows"] = rows_markup
    return made
