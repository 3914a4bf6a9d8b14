"""Every signal of every database in a folder, decoded from random payloads by the service's tables and by cantools.

    python -m benchmarks.corpus_decode FOLDER [--payloads 100] [--seed 1]

Prints, for each file, how many values were compared and how many of them differ in any bit (status 1 if any does), and
which signals the service refuses and why. Nothing of the files is kept.
"""

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from cantools.database.can import Message

from diag_service.decoding.codec import MessageTable, message_table
from diag_service.decoding.decode import payload_words
from diag_service.definitions.database import load_database
from diag_service.errors import ConfigError
from diag_service.frames import FD_PAYLOAD_BYTES, PAYLOAD_BYTES
from tests.cantools_oracle import is_sound, reference

UInt8Array = npt.NDArray[np.uint8]
FloatArray = npt.NDArray[np.float64]
SUFFIXES = frozenset({".dbc", ".kcd", ".arxml", ".sym"})
SHOWN_REFUSALS = 5


@dataclass(slots=True, kw_only=True)
class Tally:
    """What was found in one file."""

    messages: int = 0
    overlapping: int = 0  # messages with signals that share bits: each signal is compared in a message of its own
    signals: int = 0
    values: int = 0
    different: int = 0
    absent: int = 0  # on a page of a multiplexer that the payload does not select

    def compare(self, message: Message, table: MessageTable, data: UInt8Array) -> None:
        """Compare all signals of a message on some payloads."""
        self.messages += 1
        self.overlapping += not is_sound(message)
        words = payload_words(data)
        wanted = reference(message, [row[: message.length].tobytes() for row in data])
        for name, signal in table.signals.items():
            decoded = signal.decode(words)
            is_good = np.ones(len(data), np.bool_) if decoded.is_good is None else decoded.is_good
            is_there = signal_is_there(message, name, wanted[name], is_good)
            self.signals += 1
            self.absent += int(np.count_nonzero(~is_there))
            self.values += int(np.count_nonzero(is_there))
            self.different += differences(decoded.value[is_there], wanted[name][is_there])
            self.different += int(np.count_nonzero(is_good & ~is_there))


def signal_is_there(
    message: Message, name: str, wanted: FloatArray, is_good: npt.NDArray[np.bool_]
) -> npt.NDArray[np.bool_]:
    """Return which payloads carry a signal; a float that is no number is there only if it is not multiplexed out."""
    signal = message.get_signal_by_name(name)
    if signal.conversion.is_float and signal.multiplexer_ids is None:
        return np.ones_like(is_good)
    return ~np.isnan(wanted)


def differences(actual: FloatArray, wanted: FloatArray) -> int:
    """Return how many values differ in any bit; any NaN is as good as another."""
    both_nan = np.isnan(actual) & np.isnan(wanted)
    return int(np.count_nonzero((actual.view(np.uint64) != wanted.view(np.uint64)) & ~both_nan))


def payloads(message: Message, count: int, rng: np.random.Generator) -> UInt8Array:
    """Return random payloads of a message, all zeros first and all ones second, as wide as a batch has them."""
    data = np.zeros((count, PAYLOAD_BYTES if message.length <= PAYLOAD_BYTES else FD_PAYLOAD_BYTES), np.uint8)
    size = min(message.length, FD_PAYLOAD_BYTES)
    data[:, :size] = rng.integers(0, 256, (count, size))
    data[0] = 0
    data[1, :size] = 0xFF
    return data


def report(path: Path, count: int, seed: int) -> int:
    """Compare one file and print what was found; return the number of values that differ."""
    try:
        database = load_database(path)
    except ConfigError as error:
        print(f"{path.name}: refused: {error}")
        return 0
    rng = np.random.default_rng(seed)
    tally, refusals = Tally(), []
    for message in database.messages:
        if not message.signals or message.length > FD_PAYLOAD_BYTES:
            refusals += [f"{message.name} has {message.length} bytes"] if message.signals else []
            continue
        table = message_table(message, check_range=False)
        refusals += table.refused.values()
        tally.compare(message, table, payloads(message, count, rng))
    print(
        f"{path.name}: {tally.messages} messages ({tally.overlapping} with overlapping signals), "
        f"{tally.signals} signals, {tally.values} values compared, {tally.different} different, "
        f"{tally.absent} multiplexed out, {len(refusals)} refused"
    )
    for refusal in refusals[:SHOWN_REFUSALS]:
        print(f"  refused: {refusal}")
    if len(refusals) > SHOWN_REFUSALS:
        print(f"  and {len(refusals) - SHOWN_REFUSALS} more")
    return tally.different


def databases(folder: Path) -> Iterator[Path]:
    """Yield the databases of a folder and of those below."""
    yield from sorted(path for path in folder.rglob("*") if path.suffix.lower() in SUFFIXES and path.is_file())


def main() -> int:
    """Run the comparison."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--payloads", type=int, default=100, help="payloads for each message (100)")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    found = list(databases(arguments.folder))
    different = sum(report(path, max(2, arguments.payloads), arguments.seed) for path in found)
    print(f"{len(found)} databases, {different} values that are not bit-identical to cantools")
    return 1 if different or not found else 0


if __name__ == "__main__":
    sys.exit(main())
