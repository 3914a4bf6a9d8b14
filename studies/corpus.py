"""What the service makes of logs and databases of other people: every account, the tier reached, and no friction.

    python -m studies.corpus FOLDER

Every log of the folder is analysed with our database, with the shipped J1939 profile and with every database of the
folder. For every database a simulated drive is coded into it, by the shipped profile that fits, and analysed: there are
databases for which no public log exists. The status is 1 if a friction is printed for any of them, or if frames are
not accounted for. Nothing of the folder is kept.
"""

import argparse
import subprocess
import sys
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

from canlog.errors import DefinitionError
from canlog.logs import is_log
from clutch_model.calibration import nominal_calibration
from diag_service.batch.drives import drive_of
from diag_service.batch.journal import Entry
from diag_service.batch.worker import Analyst
from diag_service.diagnosis.records import dump
from diag_service.errors import ConfigError
from diag_service.mapping.interpretation import fit_of, interpret
from diag_service.settings.config import DiagnosisConfig
from tests.support.recode import recode

DATABASES = frozenset({".dbc", ".kcd", ".arxml", ".sym"})
J1939 = Path("j1939")
FRICTION_KEYS = ('"mu_c"', '"mu_s"')


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """One way to read a log."""

    name: str
    dbc: Path | None
    profile: Path | None

    def analyse(self, log: Path) -> Entry:
        """Return what the service says of a log; raises ConfigError if the reading does not fit together."""
        config = DiagnosisConfig(
            vehicle="corpus", dbc=self.dbc, profile=self.profile, calibration=nominal_calibration(), broker=None
        )
        return Analyst(config).analyse(drive_of([log]))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the accounts; return 1 if one of them must not be."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args(arguments).folder
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    databases = [path for path in files if path.suffix.lower() in DATABASES]
    bad_count = 0
    for log in (path for path in files if path not in databases and is_log(path)):
        print(f"log {log.name}, {log.stat().st_size / 1e6:.1f} MB")
        bad_count += sum(told(reading, log) for reading in readings(databases))
    with TemporaryDirectory() as name:
        log = Path(name) / "drive.log"
        command = [sys.executable, "-m", "ecu_emulator", "record", str(log)]
        subprocess.run(command, check=True, capture_output=True)
        for database in databases:
            bad_count += synthetic(database, log)
    print(f"{bad_count} accounts with a friction or with frames that are missing in them")
    return 1 if bad_count else 0


def readings(databases: Sequence[Path]) -> Iterator[Reading]:
    """Yield the ways in which every log is read."""
    yield Reading(name="our database", dbc=None, profile=None)
    yield Reading(name="J1939", dbc=None, profile=J1939)
    for database in databases:
        yield Reading(name=database.name, dbc=database, profile=None)


def told(reading: Reading, log: Path) -> bool:
    """Print the account of a log; return whether it must not be."""
    try:
        entry = reading.analyse(log)
    except (ConfigError, DefinitionError) as exc:
        print(f"  with {reading.name}: refused: {exc}")
        return False
    summary = entry.drive["summary"]
    if not isinstance(summary, dict):
        print(f"  with {reading.name}: not read: {entry.drive['error']}")
        return False
    frames, capability = summary["frames"], summary["capability"]
    parts = ("decoded", "ignored", "unsupported", "kernel_dropped", "queue_dropped")
    accounted = sum(frames[part] for part in parts) + sum(frames["rejected"].values())
    friction = says_friction(entry)
    rejected = sum(frames["rejected"].values())
    account = f"{frames['decoded']} decoded + {frames['ignored']} ignored + {rejected} rejected"
    print(
        f"  with {reading.name}: {frames['on_bus']} frames = {account}; {frames['invalid_values']} values not available"
    )
    answer = "YES" if friction else "no"
    print(f"    tier {capability['tier'] or 'none'}, {len(entry.shifts)} shifts, friction printed: {answer}")
    if capability["missing"]:
        print(f"    {capability['missing']}")
    return friction or accounted != frames["on_bus"]


def synthetic(database: Path, log: Path) -> bool:
    """Print the account of a simulated drive in the code of a database; return whether it must not be."""
    print(f"database {database.name}, with a simulated drive")
    try:
        meaning = interpret(database, None)
    except (ConfigError, DefinitionError) as exc:
        print(f"  refused: {exc}")
        return False
    print(f"  {fit_of(meaning.database, meaning.profile).said}")
    coded = log.with_name(f"{database.stem}.log")
    recode(log, database, meaning.profile, coded)
    return told(Reading(name=f"profile {meaning.profile.name}", dbc=database, profile=None), coded)


def says_friction(entry: Entry) -> bool:
    """Return whether a friction is in anything that is said of a drive."""
    text = "".join(dump(record) for record in (entry.drive, *entry.shifts))
    return any(key in text for key in FRICTION_KEYS)


if __name__ == "__main__":
    raise SystemExit(main())
