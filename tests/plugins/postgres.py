"""Pytest plugin: a PostgreSQL of our own on a free loopback port, one server per run, one database per test."""

import shutil
from collections.abc import Iterator
from itertools import count
from pathlib import Path

import pytest
from sqlalchemy import Engine

from demo.fleet.servers import PostgresServer
from fleet_backend.database import open_database
from fleet_backend.migrate import migrate

_FAST = ("fsync=off", "max_connections=40", "shared_buffers=32MB")
_numbers = count(1)


@pytest.fixture(scope="session")
def postgres_server() -> Iterator[PostgresServer]:
    """Return a running server that ends with the run; its data survive nothing else."""
    server = PostgresServer(_FAST)
    try:
        server.start()
        yield server
    finally:
        server.close()


@pytest.fixture(scope="session")
def postgres_template(postgres_server: PostgresServer) -> str:
    """Return the name of a database with the present schema, to be copied."""
    name = "ready"
    _migrated(postgres_server.create(name)).dispose()
    return name


@pytest.fixture(scope="session")
def sqlite_template(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return an SQLite file with the present schema, to be copied."""
    path = tmp_path_factory.mktemp("sqlite") / "ready.sqlite"
    _migrated(f"sqlite:///{path}").dispose()
    return path


@pytest.fixture
def postgres_url(postgres_server: PostgresServer, postgres_template: str) -> str:
    """Return the address of a PostgreSQL database with the present schema."""
    return postgres_server.create(f"test{next(_numbers)}", postgres_template)


@pytest.fixture
def sqlite_url(sqlite_template: Path, tmp_path: Path) -> str:
    """Return the address of an SQLite database with the present schema."""
    path = shutil.copy(sqlite_template, tmp_path / "fleet.sqlite")
    return f"sqlite:///{path}"


@pytest.fixture
def sqlite_engine(sqlite_url: str) -> Iterator[Engine]:
    """Yield an SQLite database with the present schema."""
    engine = open_database(sqlite_url)
    yield engine
    engine.dispose()


@pytest.fixture
def postgres_engine(postgres_url: str) -> Iterator[Engine]:
    """Yield a PostgreSQL database with the present schema."""
    engine = open_database(postgres_url)
    yield engine
    engine.dispose()


@pytest.fixture(params=["sqlite", "postgresql"])
def empty_database(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """Return the address of an empty database of each kind."""
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path / 'empty.sqlite'}"
    server = request.getfixturevalue("postgres_server")
    assert isinstance(server, PostgresServer)
    return server.create(f"test{next(_numbers)}")


@pytest.fixture(params=["sqlite", "postgresql"])
def database(request: pytest.FixtureRequest) -> str:
    """Return the address of a database of each kind with the present schema."""
    address = request.getfixturevalue("sqlite_url" if request.param == "sqlite" else "postgres_url")
    assert isinstance(address, str)
    return address


@pytest.fixture
def engine(database: str) -> Iterator[Engine]:
    """Return an open database of each kind with the present schema."""
    opened = open_database(database)
    yield opened
    opened.dispose()


def _migrated(address: str) -> Engine:
    engine = open_database(address)
    migrate(engine)
    return engine
