"""A PostgreSQL whose disk fills up while vehicles go on: what the worker does, what is lost. It mounts a disk, as root.

The tables are on the small disk and the server's journal on another, as it is usual; a server that cannot write its
journal stops, and is its service manager's to start again.

    python -m studies.fleet_full_disk
"""

import argparse
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory

from studies.fleet_ingest import BROKER_LINES
from demo.fleet.servers import PostgresServer, mosquitto
from diag_service.diagnosis.records import shift_record
from fleet_backend.database import open_database
from fleet_backend.migrate import migrate
from fleet_backend.queries import result_count
from fleet_contract import shift_message
from tests.plugins.disk import fill_up
from tests.support.fleet import fleet_result
from tests.support.fleet_worker import worker
from tests.support.resending_edge import ResendingEdge

DISK = "size=24m"
DELIVER_S = 300.0


@contextmanager
def small_disk(parent: Path) -> Iterator[Path]:
    """Mount a small file system in a folder and yield where."""
    disk = parent / "disk"
    disk.mkdir()
    subprocess.run(["mount", "-t", "tmpfs", "-o", DISK, "tmpfs", str(disk)], check=True)
    try:
        disk.chmod(0o777)
        yield disk
    finally:
        subprocess.run(["umount", "-l", str(disk)], check=True)


def measure(count: int, full_s: float) -> bool:
    """Fill the disk, go on, make room, wait for calm; return whether nothing is lost."""
    with ExitStack() as stack:
        folder = Path(stack.enter_context(TemporaryDirectory()))
        server = PostgresServer()
        stack.callback(server.close)
        server.start()
        stack.callback(server.stop)  # before its disk goes
        disk = stack.enter_context(small_disk(server.folder))
        place = disk / "tables"
        place.mkdir()
        os.chown(place, server.folder.stat().st_uid, -1)
        database = server.create_on(place, "fleet")
        engine = open_database(database)
        stack.callback(engine.dispose)
        migrate(engine)
        port = stack.enter_context(mosquitto(folder, BROKER_LINES))
        stack.enter_context(worker(folder, f"mqtt://127.0.0.1:{port}", database))
        edge = stack.enter_context(ResendingEdge(port))
        filler = fill_up(disk)
        edge.keep([shift_message(shift_record(fleet_result(seq))) for seq in range(1, count + 1)])
        log, end_s = folder / "worker-0.log", time.monotonic() + full_s
        while time.monotonic() < end_s or "trying again" not in log.read_text(encoding="utf-8"):
            edge.send_once()
            time.sleep(1.0)
        before, waiting = result_count(engine), edge.waiting_count
        filler.unlink()
        room_s = time.monotonic()
        edge.deliver(DELIVER_S)
        calm_s, stored = time.monotonic() - room_s, result_count(engine)
    print(
        f"disk full for {full_s:g} s: {before:,} of {count:,} results stored and {waiting:,} without a receipt;"
        f" {calm_s:.1f} s after there was room: {stored:,} stored, {count - stored:,} lost"
    )
    return stored == count


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--results", type=int, default=2000)
    parser.add_argument("--seconds", type=float, default=20.0, help="without room")
    options = parser.parse_args()
    return 0 if measure(options.results, options.seconds) else 1


if __name__ == "__main__":
    sys.exit(main())
