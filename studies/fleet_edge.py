"""A vehicle's service without its bus: stores results at a steady rate and lets the real outbox deliver them.

Killed and started again with the same store it goes on where the store stands. It ends when nothing waits any more.
"""

import argparse
import asyncio
import contextlib
import json
import sys
from contextlib import AbstractAsyncContextManager, closing
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Final

from clutch_results.records import ShiftResult, iso_utc, shift_from
from diag_service.delivery import Acknowledge, Link, MqttConnector, Outbox
from diag_service.store import ResultStore, VehicleState, Versions
from fleet_link import BrokerAddress

STATE: Final = VehicleState(filter_state={}, condition={}, versions=Versions(algorithm="a", calibration="c"))
AT_WORK, ALL_MADE = "at work", "all made"  # said on standard error
_LOOK_S: Final = 0.1


async def drive(store: ResultStore, vehicle: str, port: int, like: ShiftResult, count: int, rate_per_s: float) -> None:
    """Produce results like one up to ``count`` in all, and return when the backend has acknowledged every one."""
    connector = MqttConnector(BrokerAddress(host="127.0.0.1", port=port), f"clutchdiag-{vehicle}", is_persistent=True)

    def connect() -> AbstractAsyncContextManager[Link]:
        return connector.connect(iso_utc(datetime.now(UTC)))

    outbox = Outbox(store, vehicle, connect, f"127.0.0.1:{port}", acknowledge=Acknowledge.BACKEND)
    sender = asyncio.create_task(outbox.run())
    sys.stderr.write(f"{AT_WORK}\n")
    sys.stderr.flush()
    while (seq := store.next_seq()) <= count:
        result = replace(like, vehicle=vehicle, stream=store.stream, seq=seq)
        await asyncio.to_thread(store.add, result, STATE)
        outbox.wake()
        await asyncio.sleep(1.0 / rate_per_s)
    sys.stderr.write(f"{ALL_MADE}\n")
    sys.stderr.flush()
    while store.unpublished_count(vehicle):  # noqa: ASYNC110 - the store tells nobody
        await asyncio.sleep(_LOOK_S)
    sender.cancel()
    with contextlib.suppress(asyncio.CancelledError):
        await sender


def main() -> None:
    """Run one vehicle to its end."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--like", type=Path, required=True, help="a result as JSON")
    parser.add_argument("--store", type=Path, required=True)
    parser.add_argument("--vehicle", required=True)
    parser.add_argument("--broker", type=int, required=True, metavar="PORT")
    parser.add_argument("--results", type=int, required=True)
    parser.add_argument("--rate", type=float, required=True, help="results per second")
    options = parser.parse_args()
    like = shift_from(json.loads(options.like.read_text(encoding="utf-8")))
    with closing(ResultStore.open(options.store)) as store:
        asyncio.run(drive(store, options.vehicle, options.broker, like, options.results, options.rate))


if __name__ == "__main__":
    main()
