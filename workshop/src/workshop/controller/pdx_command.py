"""``ecu-emulator pdx``, and the same from Python: what a tester can ask as a PDX package."""

import os
from pathlib import Path
from types import SimpleNamespace

from ecu_emulator.commands import save
from ecu_emulator.errors import EmulatorConfigError, LogFormatExtraError
from ecu_emulator.progress import people, print_json
from workshop.controller.table import DiagnosticTable, load_table, shipped_table


def execute(options: SimpleNamespace) -> None:
    """Write what a controller can be asked for diagnostic tools, and say so; raises what ``save_pdx`` raises."""
    path = options.output
    described, size_bytes = save_pdx(options.table, path, is_forced=options.force)
    people().print(
        f"{path}: {described.name}, {len(described.services)} services, {len(described.data)} data, "
        f"{len(described.routines)} routines, {len(described.troubles)} trouble codes",
        markup=False,
    )
    if options.json:
        print_json({"file": str(path), "controller": described.name, "bytes": size_bytes})


def save_pdx(table: Path | None, path: Path, *, is_forced: bool) -> tuple[DiagnosticTable, int]:
    """Write a PDX package of a table, or of the one that ships; return what it describes, and its size [bytes].

    Raises ConfigError, RecordError if the table cannot be used, or the file is there already or cannot be written,
    ExtraMissingError if odxtools is not installed.
    """
    try:
        from workshop.controller.pdx.package import pdx_package  # noqa: PLC0415 - an extra
    except ImportError as exc:
        raise LogFormatExtraError("PDX files need odxtools: pip install './workshop[odx]' in the checkout") from exc

    if table is not None and path.absolute() == table.absolute():
        raise EmulatorConfigError(f"table and package cannot both be {path}")
    described = shipped_table() if table is None else load_table(table)
    package = pdx_package(described)
    save(package, path, is_forced=is_forced)
    return described, len(package)


def write_pdx(output: str | os.PathLike[str], table: str | os.PathLike[str] | None = None) -> int:
    """Write a PDX package (ODX 2.2) of what a tester can ask, as ``ecu-emulator pdx`` does; needs the extra ``odx``.

    Parameters
    ----------
    output
        The package; one that is there is replaced.
    table
        A TOML file that describes a controller of your own; by default the one that ships.

    Returns
    -------
    int
        Its size [bytes].

    Raises
    ------
    ConfigError, RecordError
        If the table cannot be used, or the package cannot be written.
    ExtraMissingError
        If odxtools is not installed.
    """
    _, size_bytes = save_pdx(None if table is None else Path(table), Path(output), is_forced=True)
    return size_bytes
