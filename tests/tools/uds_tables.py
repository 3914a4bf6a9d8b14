"""Prints the tables of the emulated controller as a page of the site: ``python -m tests.tools.uds_tables``."""

from collections.abc import Iterable, Sequence

from workshop.controller.descriptions import AccessRule, Coding, DataIdentifier, DatumField
from workshop.controller.table import DiagnosticTable, shipped_table


def page(table: DiagnosticTable) -> str:
    """Return the page that lists what a controller has."""
    tables = {
        "Services": _services(table),
        "Data": _data(table),
        "Conditions": _conditions(table),
        "Trouble codes": _codes(table),
        "Faults that lead to trouble codes": _faults(table),
        "Routines": _routines(table),
        "OBD parameters": _parameters(table),
        "OBD monitors": _monitors(table),
        "OBD vehicle information": _information(table),
    }
    parts = [f"## {name}\n\n{text}" for name, text in tables.items()]
    return "\n".join(["# Tables of the emulated controller\n", *parts])


def _rows(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def _services(table: DiagnosticTable) -> str:
    return _rows(
        ("service", "name", "sessions", "needs"),
        (
            (f"{entry.number:02X}", entry.name, _sessions(entry.sessions), ", ".join(entry.conditions))
            for entry in table.services.values()
        ),
    )


def _sessions(numbers: Iterable[int]) -> str:
    return ", ".join(f"{number:02X}" for number in numbers)


def _access(access: AccessRule | None) -> str:
    if access is None:
        return ""
    level = " or ".join(f"level {number}" for number in access.levels)
    return "; ".join(part for part in (_sessions(access.sessions), level, ", ".join(access.conditions)) if part)


def _data(table: DiagnosticTable) -> str:
    return _rows(
        ("data", "name", "bytes", "read", "write"),
        ((f"{entry.number:04X}", entry.name, _layout(entry), *map(_access, (entry.read, entry.write)))
         for entry in table.data.values()),
    )  # fmt: skip


def _layout(datum: DataIdentifier) -> str:
    return "; ".join(map(_field, datum.fields))


def _field(entry: DatumField) -> str:
    if entry.kind in {Coding.TEXT, Coding.BYTES, Coding.FLOAT}:
        return f"{entry.name}: {entry.size_bytes}, {entry.kind}"
    scale = "" if entry.resolution == 1.0 and not entry.unit else f", {entry.resolution:g} {entry.unit}".rstrip()
    offset = f" from {entry.offset:g}" if entry.offset else ""
    return f"{entry.name}: {entry.size_bytes}{', signed' if entry.kind is Coding.SIGNED else ''}{scale}{offset}"


def _routines(table: DiagnosticTable) -> str:
    return _rows(
        ("routine", "name", "needs", "options", "results"),
        (
            (
                f"{entry.number:04X}",
                entry.name,
                _access(entry.access),
                "; ".join(map(_field, entry.options)),
                "; ".join(map(_field, entry.results)),
            )
            for entry in table.routines.values()
        ),
    )


def _conditions(table: DiagnosticTable) -> str:
    return _rows(
        ("condition", "value", "least", "most", "response"),
        (
            (
                entry.name,
                f"`{entry.source}`",
                "" if entry.minimum is None else f"{entry.minimum:g}",
                "" if entry.maximum is None else f"{entry.maximum:g}",
                f"{entry.nrc:02X}",
            )
            for entry in table.conditions.values()
        ),
    )


def _codes(table: DiagnosticTable) -> str:
    return _rows(
        ("code", "bytes", "text", "lamp", "cycles to confirm", "to heal", "to forget"),
        (
            (
                entry.code, f"{entry.number:06X}", entry.text, "yes" if entry.lights_lamp else "",
                str(entry.confirm_cycles),
                str(entry.heal_cycles) if entry.lights_lamp else "", str(entry.age_cycles),
            )
            for entry in table.troubles.values()
        ),
    )  # fmt: skip


def _faults(table: DiagnosticTable) -> str:
    codes: dict[str, list[str]] = {}
    for trouble in table.troubles.values():
        if trouble.faults:
            words = (", ".join(f"{key} {value}" for key, value in fault.items()) for fault in trouble.faults)
            codes.setdefault("; ".join(words), []).append(trouble.code)
    return _rows(("faults", "codes"), ((faults, ", ".join(group)) for faults, group in codes.items()))


def _parameters(table: DiagnosticTable) -> str:
    pids = table.obd.pids.values() if table.obd is not None else ()
    return _rows(
        ("PID", "name", "bytes", "in the freeze frame"),
        (
            (f"{entry.number:02X}", entry.name, "; ".join(map(_field, entry.fields)), "yes" if entry.is_frozen else "")
            for entry in pids
        ),
    )


def _information(table: DiagnosticTable) -> str:
    infos = table.obd.infos.values() if table.obd is not None else ()
    return _rows(
        ("information", "name", "bytes", "is"),
        (
            (
                f"{entry.number:02X}", entry.name, str(entry.size_bytes),
                f"data `{entry.data:04X}`" if entry.data is not None else
                f"`{entry.digits or entry.text.replace(chr(0), ' ')}`",
            )
            for entry in infos
        ),
    )  # fmt: skip


def _monitors(table: DiagnosticTable) -> str:
    monitors = table.obd.monitors.values() if table.obd is not None else ()
    return _rows(("monitor", "code"), ((f"{entry.number:02X}", entry.code) for entry in monitors))


if __name__ == "__main__":
    print(page(shipped_table()), end="")
