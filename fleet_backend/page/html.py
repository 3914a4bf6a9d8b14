"""Pages as HTML: templates of this package, parts and style sheet of all pages; everything is escaped."""

from functools import cache
from typing import Final

from jinja2 import Environment
from markupsafe import Markup

from clutchdiag_io.pages.content import Link, templates_of
from fleet_backend.page.access import NOBODY, Viewer
from fleet_backend.page.view import Drawn, Shown, View

NAVIGATION: Final = (
    Link(text="Fleet", href="/"),
    Link(text="Clutches", href="/clutches"),
    Link(text="Alarms", href="/alarms"),
    Link(text="Maintenance", href="/maintenance"),
    Link(text="Changes", href="/changes"),
    Link(text="Quarantine", href="/quarantine"),
)


def html_of(view: View, drawn: Drawn, *, viewer: Viewer, api_href: str, number: int, complaint: str | None) -> str:
    """Return the page of an answer.

    Parameters
    ----------
    api_href :
        Address of the same answer for programs.
    viewer :
        Who reads it.
    number :
        Of the snapshot that it is from.
    complaint :
        Why what is shown is older than it should be, if it is.
    """
    return (
        _templates()
        .get_template("view.html")
        .render(
            page=drawn.shown,
            body=drawn.body,
            navigation=NAVIGATION,
            viewer=viewer,
            here=view.page_path,
            api_href=api_href,
            complaint=complaint,
            number=number,
        )
    )


def body_of(shown: Shown) -> Markup:
    """Return the sections of a page, which are the most of it and the same for all readers."""
    return Markup(_templates().get_template("body.html").render(page=shown))  # noqa: S704 - a template escapes


def problem_page(title: str, detail: str) -> str:
    """Return the page of something that went wrong."""
    template = _templates().get_template("problem.html")
    return template.render(title=title, detail=detail, navigation=NAVIGATION, here="", viewer=NOBODY)


@cache
def _templates() -> Environment:
    return templates_of("fleet_backend.page")
