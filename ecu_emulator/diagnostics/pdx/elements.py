"""Elements of ODX, in the order and with the names that its schema wants."""

import re
from collections.abc import Mapping
from typing import Final
from xml.etree.ElementTree import Element, indent, tostring

_NOT_IN_NAMES: Final = re.compile(r"[^A-Za-z0-9_]+")
_NOT_IN_XML: Final = re.compile("[^\t\n\r\u0020-\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_LONGEST_NAME: Final = 100  # of 128 that ODX allows; what makes a name unique comes on top


def node(tag: str, *parts: Element | Mapping[str, str] | str | None) -> Element:
    """Return an element with children, attributes and text, as they come; None is passed over."""
    made = Element(tag)
    for part in parts:
        if isinstance(part, Element):
            made.append(part)
        elif isinstance(part, str):
            made.text = _NOT_IN_XML.sub("?", part)
        elif part is not None:
            made.attrib.update({key: _NOT_IN_XML.sub("?", value) for key, value in part.items()})
    return made


def listed(tag: str, *children: Element) -> Element | None:
    """Return an element that must not be empty, or none."""
    return node(tag, *children) if children else None


def named(tag: str, kind: str, name: str, long_name: str = "", text: str = "", **attributes: str) -> Element:
    """Return an element that others refer to by its kind and name."""
    return node(tag, {"ID": identifier(kind, name), **attributes}, *title(name, long_name, text))


def title(name: str, long_name: str = "", text: str = "") -> tuple[Element | None, ...]:
    """Return what begins every named element: a name, one for people, and what else is to be said."""
    return (
        node("SHORT-NAME", name),
        node("LONG-NAME", long_name) if long_name else None,
        node("DESC", node("p", text)) if text else None,
    )


def identifier(kind: str, name: str) -> str:
    """Return what a reference within the same file names."""
    return f"{kind}.{name}"


def reference(tag: str, kind: str, name: str, **attributes: str) -> Element:
    """Return a reference to a named element."""
    return node(tag, {"ID-REF": identifier(kind, name), **attributes})


def short_name(text: str) -> str:
    """Return a text as ODX allows it for a name."""
    return _NOT_IN_NAMES.sub("_", text).strip("_")[:_LONGEST_NAME] or "unnamed"


class Names:
    """Names that were given, so that none is given twice; tools may take upper and lower case for the same."""

    def __init__(self) -> None:
        self._taken: set[str] = set()

    def new(self, text: str) -> str:
        """Return a name like this one that nothing else has."""
        wanted = short_name(text)
        name, count = wanted, 1
        while name.lower() in self._taken:
            count += 1
            name = f"{wanted}_{count}"
        self._taken.add(name.lower())
        return name


def document(content: Element) -> bytes:
    """Return a file of ODX."""
    root = node(
        "ODX",
        {
            "MODEL-VERSION": "2.2.0",
            "xmlns:xsi": "http://www.w3.org/2001/XMLSchema-instance",
            "xsi:noNamespaceSchemaLocation": "odx.xsd",
        },
        content,
    )
    return written(root)


def written(root: Element) -> bytes:
    """Return the bytes of an XML file."""
    indent(root)
    text: bytes = tostring(root, encoding="UTF-8", xml_declaration=True)
    return text + b"\n"
