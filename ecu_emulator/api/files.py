"""The database and the PDX package of the emulated vehicle, from Python."""

from pathlib import Path

from ecu_emulator.api.emulator import AnyPath
from ecu_emulator.commands import save_dbc, save_pdx


def write_dbc(output: AnyPath) -> int:
    """Write the DBC file of the emulated vehicle, as ``ecu-emulator dbc`` does; one that is there is replaced.

    Returns its size [bytes]. Raises RecordError if it cannot be written.
    """
    return save_dbc(Path(output), is_forced=True)


def write_pdx(output: AnyPath, table: AnyPath | None = None) -> int:
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
