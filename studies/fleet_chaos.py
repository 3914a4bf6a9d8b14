"""Nothing lost, nothing twice: 8,000 results of 4 vehicles while broker, workers and vehicles are killed with SIGKILL.

Three times: with a broker that saves at every change, with one that saves as Mosquitto is shipped, and with one whose
file is deleted once; or once with JetStream of a nats-server in its place. Every vehicle runs the real outbox, the
workers write into a real PostgreSQL.

    python -m studies.fleet_chaos
    python -m studies.fleet_chaos --broker nats
"""

import argparse
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory

from demo.fleet.servers import PostgresServer
from tests.support.chaos.storm import Account, BrokerDisk, Plan, Storm


def told(title: str, account: Account) -> str:
    kills = ", ".join(f"{part} {count}" for part, count in account.kills.items())
    drained = (
        "NOT EMPTY IN TIME" if account.drained_s is None else f"empty {account.drained_s:.1f} s after the last kill"
    )
    same = "equal" if account.is_equal else "NOT EQUAL"
    return (
        f"{title}: {account.made} of {account.planned} made, {account.stored} stored,"
        f" {account.waiting} waiting, {account.lost} lost;"
        f" table {same} to a clean run; outboxes {drained}; killed: {kills}"
    )


def is_met(account: Account) -> bool:
    """Return whether everything planned is in the database, once, and every outbox is empty in time."""
    return account.is_equal and account.stored == account.planned and account.drained_s is not None


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--results", type=int, default=Plan().results_per_edge, help="per vehicle")
    parser.add_argument("--seconds", type=float, default=Plan().storm_s, help="of the storm")
    parser.add_argument("--calm", type=float, default=Plan().calm_s, help="seconds in which outboxes must be empty")
    parser.add_argument("--disk", type=BrokerDisk, choices=list(BrokerDisk), help="only this one")
    parser.add_argument("--broker", choices=["mosquitto", "nats"], default="mosquitto")
    options = parser.parse_args()
    plan = Plan(results_per_edge=options.results, storm_s=options.seconds, calm_s=options.calm)
    is_nats = options.broker == "nats"
    if is_nats:
        options.disk = BrokerDisk.SAVED
    disks = list(BrokerDisk) if options.disk is None else [options.disk]
    is_good = True
    with closing(PostgresServer()) as server:
        server.start()
        for disk in disks:
            with TemporaryDirectory() as folder:
                account = Storm(
                    Path(folder), server.create(disk.value), replace(plan, disk=disk, is_nats=is_nats)
                ).run()
            print(told("JetStream" if is_nats else f"broker's disk {disk.value}", account), flush=True)
            is_good = is_good and is_met(account)
    return 0 if is_good else 1


if __name__ == "__main__":
    sys.exit(main())
