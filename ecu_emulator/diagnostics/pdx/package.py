"""A PDX package: files of ODX and their catalogue in one archive, the same bytes for the same table."""

import io
import zipfile
from typing import Final

from ecu_emulator.diagnostics.pdx.communication import SPECIFICATION, specification, subsets
from ecu_emulator.diagnostics.pdx.elements import document, node, written
from ecu_emulator.diagnostics.pdx.layer import (
    container_name,
    layer_container,
    obd_container,
    obd_container_name,
)
from ecu_emulator.diagnostics.table import DiagnosticTable

DATE: Final = "2026-01-01T00:00:00"  # of every file: a package says what the table says, not when it was asked
_ZIP_DATE: Final = (2026, 1, 1, 0, 0, 0)
_UNIX: Final = 3
_KINDS: Final = {".odx-d": "diagnostic layers", ".odx-c": "protocol", ".odx-cs": "communication parameters"}


def pdx_package(table: DiagnosticTable) -> bytes:
    """Return the bytes of a PDX file that describes what a table describes."""
    obd = obd_container(table)
    files = {
        f"{container_name(table)}.odx-d": document(layer_container(table)),
        **({} if obd is None else {f"{obd_container_name(table)}.odx-d": document(obd)}),
        f"{SPECIFICATION}.odx-c": document(specification()),
        **{f"{name}.odx-cs": document(subset) for name, subset in subsets().items()},
    }
    content = io.BytesIO()
    with zipfile.ZipFile(content, "w") as archive:
        for name, data in {"index.xml": _catalogue(container_name(table), tuple(files)), **files}.items():
            entry = zipfile.ZipInfo(name, _ZIP_DATE)
            entry.create_system, entry.external_attr = _UNIX, 0o644 << 16
            archive.writestr(entry, data, zipfile.ZIP_DEFLATED, 9)
    return content.getvalue()


def _catalogue(name: str, files: tuple[str, ...]) -> bytes:
    blocks = (
        node(
            "ABLOCK",
            {"UPD": "UNCHANGED"},
            node("SHORT-NAME", f"file_{place}"),
            node("LONG-NAME", _KINDS[file[file.rindex(".") :]]),
            node(
                "FILES",
                node("FILE", {"CREATION-DATE": DATE, "MIME-TYPE": f"application/x-asam.odx.{_suffix(file)}"}, file),
            ),
        )
        for place, file in enumerate(files, start=1)
    )
    attributes = {
        "F-DTD-VERSION": "ODX-2.2.0",
        "xmlns:xsi": "http://www.w3.org/2001/XMLSchema-instance",
        "xsi:noNamespaceSchemaLocation": "odx-cc.xsd",
    }
    return written(node("CATALOG", attributes, node("SHORT-NAME", name), node("ABLOCKS", *blocks)))


def _suffix(file: str) -> str:
    return file[file.rindex(".") + 1 :]
