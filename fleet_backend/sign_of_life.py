"""A file whose age tells whether a worker can work: what a container's health check can look at."""

import asyncio
from pathlib import Path
from typing import Final

from sqlalchemy import Engine, select
from sqlalchemy.exc import SQLAlchemyError

from clutchdiag_io.files import give_sign, make_sign
from fleet_backend.errors import ConfigError
from fleet_backend.ingest import Worker

PERIOD_S: Final = 5.0
RETRY_S: Final = 0.5  # how soon it is told that all is well again


def prepare(path: Path) -> None:
    """Make the file, from 1970: nothing is well yet.

    Raises
    ------
    ConfigError
        If it cannot be made.
    """
    try:
        make_sign(path)
    except OSError as exc:
        raise ConfigError(f"cannot touch {path}: {exc.strerror}") from exc


async def give_signs(path: Path, worker: Worker, engine: Engine, period_s: float = PERIOD_S) -> None:
    """Touch a file every ``period_s``, for ever, while the worker listens to its broker and the database answers.

    A database that hangs touches nothing.
    """
    while True:
        is_well = worker.is_listening and await asyncio.to_thread(answers, engine)
        if is_well:
            give_sign(path)
        await asyncio.sleep(period_s if is_well else min(RETRY_S, period_s))


def answers(engine: Engine) -> bool:
    """Return whether the database answers."""
    try:
        with engine.connect() as connection:
            connection.execute(select(1))
    except SQLAlchemyError:
        return False
    return True
