"""Files that the program wrote before the house was laid out anew (commit a65d50d), for the present one to take over.

``edge.sql`` is the store of two vehicles. Car 1 has thirty shifts of a noise-only drive, three of a live service, and
the ten of ``recordings/noise_only``: baselines of both clutches, five results delivered, one quarantined, the rest
waiting. Car 2 has the ten of ``recordings/routine``, judged by ``calibration.toml``, which ``calibrate`` made of the
same recording. ``fleet.sql`` is a fleet database with the first results of both, a status and a message it could not
use, which later programs have brought to the schema r0021. ``postgres.sql`` is that schema in PostgreSQL, without rows.
"""

import lzma
import sqlite3
from contextlib import closing
from pathlib import Path

FOLDER = Path(__file__).parent
CALIBRATION = FOLDER / "calibration.toml"


def text(name: str) -> str:
    """Return what one of the packed files holds."""
    return lzma.decompress((FOLDER / f"{name}.xz").read_bytes()).decode()


def database(name: str, path: Path) -> Path:
    """Make the SQLite file that one of the packed dumps came from."""
    path.touch(0o600)
    with closing(sqlite3.connect(path)) as connection:
        connection.executescript(text(name))
    return path
