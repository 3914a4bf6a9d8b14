"""The backups of docs/fleet.md, played: what is restored is what was there; a gap is told and filled."""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from uuid import uuid4

from sqlalchemy import Engine, text

from demo.fleet.servers import PostgresServer
from fleet_backend import queries
from fleet_backend.database import open_database, transaction
from fleet_backend.migrate import check_schema
from fleet_backend.page.queries import DatabaseSource
from fleet_backend.writer import Batch, Writer
from tests.support.fleet import START, fleet_result, row_of
from tests.support.patience import HANG_S

PAGE = (Path(__file__).parents[2] / "docs" / "fleet.md").read_text(encoding="utf-8")
BACKUP = PAGE.partition("## Backup and restore")[2].partition("\n## ")[0]


def store(engine: Engine, first: int, last: int) -> None:
    rows = [row_of(fleet_result(seq, clutch=1 + seq % 2)) for seq in range(first, last + 1)]
    Writer(engine).store(Batch(shifts=rows))


def played(program: str, places: dict[str, str], folder: Path) -> None:
    """Run a command of the page, with other places."""
    line = next(line for line in BACKUP.splitlines() if line.startswith(f"{program} "))
    for name, place in places.items():
        assert name in BACKUP
        line = line.replace(name, place)
    subprocess.run(shlex.split(line, comments=True), check=True, timeout=HANG_S, cwd=folder)


def missing_count(engine: Engine) -> int:
    """Return how many results are missing by the query of the page."""
    (query,) = [line for line in BACKUP.splitlines() if line.startswith("SELECT ")]
    with transaction(engine) as connection:
        return sum(row[-1] for row in connection.execute(text(query)))


def check(before: Engine, restored: Engine) -> None:
    """Make sure of a database that was backed up after forty of sixty results."""
    check_schema(restored)
    assert queries.result_count(restored) == 40
    assert [one.fluid for one in DatabaseSource(restored).all_clutches()] == ["DCTF", "DCTF"]
    store(restored, 51, 60)  # nobody had acknowledged these: they come by themselves
    assert missing_count(restored) == 10
    store(restored, 41, 55)  # acknowledged behind the backup; their vehicle has them still
    assert missing_count(restored) == 0
    assert queries.table_hash(restored) == queries.table_hash(before)
    assert [(one.clutch, one.seq) for one in DatabaseSource(restored).all_clutches()] == [
        (one.clutch, one.seq) for one in DatabaseSource(before).all_clutches()
    ]


def test_a_postgresql_is_backed_up_while_it_runs_and_restored_elsewhere(
    tmp_path: Path, postgres_server: PostgresServer, postgres_template: str
) -> None:
    old, new = f"fleet_{uuid4().hex}", f"empty_{uuid4().hex}"
    places = {
        "postgresql://fleet@db.example/fleet": postgres_server.create(old, postgres_template),
        "postgresql://fleet@db.example/empty": postgres_server.create(new),
    }
    places = {name: url.replace("postgresql+psycopg:", "postgresql:") for name, url in places.items()}
    engine, restored = map(open_database, places.values())
    store(engine, 1, 40)
    queries.note_fill(engine, "car1", "DCTF", at=START, odometer_m=None, note=None)
    played("pg_dump", places, tmp_path)
    store(engine, 41, 60)
    played("pg_restore", places, tmp_path)
    check(engine, restored)
    engine.dispose()
    restored.dispose()


def test_the_rows_of_an_old_postgresql_are_taken_over(postgres_server: PostgresServer, postgres_template: str) -> None:
    old, new = (postgres_server.create(f"rows_{uuid4().hex}", postgres_template) for _ in range(2))
    engine, taken = map(open_database, (old, new))
    store(engine, 1, 40)
    queries.note_fill(engine, "car1", "DCTF", at=START, odometer_m=None, note=None)
    (command,) = re.findall(r"pg_dump --data-only.*?/empty", BACKUP, re.DOTALL)
    for name, url in {"fleet@db.example/fleet": old, "fleet@db.example/empty": new}.items():
        command = command.replace(f"postgresql://{name}", url.replace("+psycopg", ""))
    subprocess.run(["bash", "-o", "pipefail", "-c", command], check=True, timeout=HANG_S)
    assert queries.table_hash(taken) == queries.table_hash(engine)
    assert queries.worst_first(taken) == queries.worst_first(engine)
    engine.dispose()
    taken.dispose()


def test_an_sqlite_is_backed_up_while_it_runs_and_restored_by_copying(tmp_path: Path, sqlite_template: Path) -> None:
    engine = open_database(f"sqlite:///{shutil.copyfile(sqlite_template, tmp_path / 'fleet.sqlite')}")
    store(engine, 1, 40)
    queries.note_fill(engine, "car1", "DCTF", at=START, odometer_m=None, note=None)
    played("python", {"python ": f"{sys.executable} "}, tmp_path)
    store(engine, 41, 60)
    restored = open_database(f"sqlite:///{shutil.copyfile(tmp_path / 'backup.sqlite', tmp_path / 'restored.sqlite')}")
    check(engine, restored)
    engine.dispose()
    restored.dispose()
