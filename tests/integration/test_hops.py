"""The way of one event, and of one log, stays as short as it is: own calls and modules, as `studies.hops` counts."""

import asyncio
from collections import Counter
from pathlib import Path

import pytest

from studies.hops import (
    COOL_DEGC,
    FILMS,
    listing,
    modules_of,
    record,
    trip_of_a_shift,
    trip_of_decoding,
    trips_of_a_udds,
)
from tests.plugins.broker import Mosquitto

EVENT_CALLS, EVENT_MODULES = 580, 19  # to the stored result; 80 of the calls are the indices of a shift
BROKER_MODULES = 31
UDDS_CALLS, UDDS_MODULES, UDDS_FILMS = 930, 17, 13  # of the worst event of a cool car, to its diagnosis and indices
DECODE_CALLS, DECODE_MODULES = 1_850, 32  # from a log to its table; its last moments come in a batch of their own


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("hops") / "drive.log"
    record(path, 1)
    return path


def test_an_event_is_stored_and_sent_by_few_calls_in_few_modules(log: Path, tmp_path: Path) -> None:
    broker = Mosquitto(tmp_path)
    broker.start()
    try:
        trip, stored = asyncio.run(trip_of_a_shift(log, broker.port))
    finally:
        broker.stop()
    assert stored.total() <= EVENT_CALLS, listing(stored)
    assert len(modules_of(stored)) <= EVENT_MODULES, listing(stored)
    assert len(modules_of(trip.calls)) <= BROKER_MODULES, listing(trip.calls)


def test_the_worst_event_of_a_cool_car_takes_few_calls_and_integrates_its_films_seldom() -> None:
    trips = [calls for _, calls in trips_of_a_udds(COOL_DEGC)]
    worst = max(trips, key=Counter.total)
    assert worst.total() <= UDDS_CALLS, listing(worst)
    assert len(modules_of(worst)) <= UDDS_MODULES, listing(worst)
    assert 0 < max(calls[FILMS] for calls in trips) <= UDDS_FILMS


def test_a_log_becomes_a_table_by_few_calls_in_few_modules(log: Path, tmp_path: Path) -> None:
    calls = trip_of_decoding(log, tmp_path / "drive.parquet").calls
    assert calls.total() <= DECODE_CALLS, listing(calls)
    assert len(modules_of(calls)) <= DECODE_MODULES, listing(calls)
