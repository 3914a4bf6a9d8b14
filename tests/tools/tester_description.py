"""Writes what the tester knows of the emulated controller: ``python -m tests.tools.tester_description``.

The two programs share no file: what a workshop's tester knows of a controller, it has from that controller's maker.
"""

from pathlib import Path
from typing import Any, Final

import tomli_w

from workshop.controller.descriptions import Coding, DataIdentifier, DatumField, ExtendedRecord, not_available
from workshop.controller.services.sessions import COMPLETED, RUNNING, STOPPED
from workshop.controller.table import DiagnosticTable, shipped_table

FILE: Final = Path(__file__).parents[2] / "workshop/src/workshop/tester/controllers/dct.toml"
_SYSTEM_NAME: Final = 0xF197
# Before the results ours tells how far it is: what ISO 14229-1 leaves to the maker (routineInfo).
_STATUS: Final = {
    "name": "status",
    "kind": "unsigned",
    "size_bytes": 1,
    "meanings": {str(COMPLETED): "completed", str(RUNNING): "running", str(STOPPED): "stopped"},
}
_HEAD: Final = (
    "# What the emulated controller can be asked; made by tests/tools/tester_description.py from its own table.\n"
)


def written(table: DiagnosticTable) -> str:
    """Return the description of a controller as TOML."""
    described: dict[str, Any] = {
        "name": table.name,
        "request_id": table.addressing.request_id,
        "response_id": table.addressing.response_id,
        "identity": {"number": _SYSTEM_NAME, "text": table.data[_SYSTEM_NAME].initial},
        "data": [_record(datum) for datum in table.data.values()],
        "extended": [_record(record) for record in table.extended.values()],
        "trouble": [
            {"code": trouble.code, "failure_type": trouble.failure_type, "text": trouble.text}
            for trouble in table.troubles.values()
        ],
        "routine": [
            {
                "number": routine.number,
                "name": routine.name,
                "options": [_field(entry) for entry in routine.options],
                "results": [_STATUS, *map(_field, routine.results)],
            }
            for routine in table.routines.values()
        ],
    }
    return _HEAD + tomli_w.dumps({key: value for key, value in described.items() if value != []})


def _record(record: DataIdentifier | ExtendedRecord) -> dict[str, Any]:
    return {"number": record.number, "name": record.name, "fields": [_field(entry) for entry in record.fields]}


def _field(entry: DatumField) -> dict[str, Any]:
    is_number = entry.kind in {Coding.UNSIGNED, Coding.SIGNED}
    found: dict[str, Any] = {"name": entry.name, "kind": entry.kind.value, "size_bytes": entry.size_bytes}
    found |= {"unit": entry.unit} if entry.unit else {}
    found |= {"resolution": entry.resolution} if entry.resolution != 1.0 else {}
    found |= {"offset": entry.offset} if entry.offset else {}
    found |= {"invalid": not_available(entry)} if is_number and entry.source else {}
    return found | ({"meanings": dict(entry.meanings)} if entry.meanings else {})


if __name__ == "__main__":
    FILE.write_text(written(shipped_table()), encoding="utf-8")
