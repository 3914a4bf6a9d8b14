"""What becomes of the DBC files of a folder, a row each: what is left out, and whether all values are cantools'.

Random payloads of each message are decoded. Of a file that cantools reads by itself, its own signals are the measure;
of the others cantools decodes with the messages as they were loaded. A row that fails makes the status 1.
"""

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import cantools
import numpy as np
import numpy.typing as npt
from cantools.database.can import Database, Message

from canlog.database.loading import read_database
from canlog.decode.codec import SignalBlock, message_table
from canlog.decode.signals import PayloadWords
from canlog.errors import DefinitionError
from tests.support.cantools_oracle import reference, same_bits

PAYLOADS: Final = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """What became of a database: ``error`` is empty if it was loaded, ``notices`` tell what was left out or mended."""

    path: Path
    message_count: int = 0
    notices: tuple[str, ...] = ()
    is_cantools: bool = False  # the file itself was read by cantools
    value_count: int = 0
    different: tuple[str, ...] = ()
    error: str = ""

    @property
    def is_good(self) -> bool:
        return not self.error and not self.different


def judge(path: Path) -> Row:
    """Return the row of a database."""
    try:
        loaded = read_database(path)
    except DefinitionError as error:
        return Row(path=path, error=str(error))
    measure = _of_cantools(path)
    value_count, different = 0, list[str]()
    for message in loaded.database.messages:
        own = _counterpart(message, measure)
        payloads = _payloads(message)
        wanted = reference(own, [payload[: own.length].tobytes() for payload in payloads])
        for name, values in _decoded(message, payloads).items():
            is_there = ~np.isnan(wanted[name]) if name in wanted else np.ones(PAYLOADS, np.bool_)
            value_count += int(is_there.sum())
            if name not in wanted or not same_bits(values[is_there], wanted[name][is_there]):
                different.append(f"{message.name}.{name}")
    return Row(
        path=path,
        message_count=len(loaded.database.messages),
        notices=tuple(loaded.notices),
        is_cantools=measure is not None,
        value_count=value_count,
        different=tuple(different),
    )


def _of_cantools(path: Path) -> Database | None:
    try:
        database = cantools.database.load_file(path, database_format="dbc", encoding="utf-8", strict=False)
    except (cantools.Error, UnicodeDecodeError):
        return None
    return database if isinstance(database, Database) else None


def _counterpart(message: Message, measure: Database | None) -> Message:
    """Return cantools' own message of that name and identifier with the same signals, else the message itself."""
    for own in measure.messages if measure else ():
        if (own.frame_id, own.is_extended_frame, own.name) == (
            message.frame_id,
            message.is_extended_frame,
            message.name,
        ) and {signal.name for signal in message.signals} <= {signal.name for signal in own.signals}:
            return own
    return message


def _payloads(message: Message) -> npt.NDArray[np.uint8]:
    """Return random bytes in rows as wide as a batch would have them, zeros behind the message."""
    payloads = np.zeros((PAYLOADS, max(8, -(-message.length // 8) * 8)), np.uint8)
    payloads[:, : message.length] = np.random.default_rng(message.frame_id).integers(0, 256, (PAYLOADS, message.length))
    return payloads


def _decoded(message: Message, payloads: npt.NDArray[np.uint8]) -> dict[str, npt.NDArray[np.float64]]:
    table = message_table(message, check_range=False)
    return {name: decoded.value for name, decoded in SignalBlock(table.signals).decode(PayloadWords(payloads)).items()}


def lines(row: Row, folder: Path) -> Iterator[str]:
    """Yield the row as text and below it what was left out, what differs or why nothing was loaded."""
    name = row.path.relative_to(folder)
    measure = "cantools" if row.is_cantools else "cantools, as loaded"
    verdict = "ok" if row.is_good else "FAILED"
    yield (
        f"{name!s:<60} {verdict:<6} {row.message_count:>4} messages, {row.value_count:>6} values as {measure}, "
        f"{len(row.notices)} notices"
    )
    yield from (f"    {text}" for text in row.notices)
    yield from (f"    differs: {text}" for text in row.different)
    if row.error:
        yield f"    {row.error}"


def main(arguments: list[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path, help="with DBC files, also in folders below it")
    folder = parser.parse_args(arguments).folder
    rows = []
    for path in sorted(folder.rglob("*.dbc")):
        rows.append(judge(path))
        print("\n".join(lines(rows[-1], folder)), flush=True)
    good = sum(row.is_good for row in rows)
    print(f"{good} of {len(rows)} databases loaded with right values; {sum(row.value_count for row in rows)} values")
    return 0 if rows and good == len(rows) else 1


if __name__ == "__main__":
    raise SystemExit(main())
