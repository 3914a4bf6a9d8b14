"""The fleet's page for tests: clutches made up, a database with something of everything, a server in a thread."""

import asyncio
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import httpx
from anyio.from_thread import start_blocking_portal
from sqlalchemy import Engine

from clutch_results.records import Condition
from fleet_backend import queries
from fleet_backend.ageing.records import ClutchNow
from fleet_backend.database import open_database
from fleet_backend.office.watching import Orders, Watch
from fleet_backend.page.access import Access, Proxy, UserRole
from fleet_backend.page.fleet import Keeper
from fleet_backend.page.queries import DatabaseSource
from fleet_backend.page.routes import routes
from fleet_backend.page.server import address_of, closing_socket, server_of
from fleet_backend.page.site import Sources, application
from fleet_backend.rows import quarantine_row
from fleet_backend.writer import Batch, Writer
from tests.support.fleet import NOW, fleet_result, row_of
from tests.support.histories import history
from tests.support.patience import HANG_S

MARKUP = "<img src=x onerror=alert(1)>"
FLUID = "DCTF <b>75W</b>"
SECRET = "0123456789abcdef0123456789abcdef"  # noqa: S105
ACCESS = Access(
    host_names=("127.0.0.1",),
    proxy=Proxy(user_header="X-Forwarded-User", secret_header="X-Fleet-Proxy", secret=SECRET),  # noqa: S106
    roles={"ann": UserRole.WORKSHOP, "bob": UserRole.WORKSHOP, "eve": UserRole.VIEWER},
)


def headers_of(name: str) -> dict[str, str]:
    """Return what a proxy adds to the requests of somebody."""
    return {"X-Forwarded-User": name, "X-Fleet-Proxy": SECRET}


def clutch_now(vehicle: str = "car1", clutch: int = 1, **others: object) -> ClutchNow:
    """Return the running condition of a clutch."""
    usual = ClutchNow(
        vehicle=vehicle,
        clutch=clutch,
        element=None,
        condition="good",
        condition_reason="sound",
        advice=None,
        fluid_since=None,
        action="nothing",
        order="Nothing to do now: the fluid is sound.",
        level_ratio=0.99,
        shift_count=12,
        mu_c=0.136,
        mu_s=0.12,
        std_mu_c=0.001,
        std_mu_s=0.002,
        correlation=0.3,
        slope_s_rad=0.002,
        std_slope_s_rad=0.0004,
        probability_negative_slope=0.01,
        score=88.0,
        odometer_m=1.0e6,
        end_at=NOW,
        stored_at=NOW,
        fluid=None,
        stream="stream-1",
        seq=1,
        algorithm_version="algorithm-1",
        calibration_version="nominal-1",
        tier=1,
    )
    return replace(usual, **others)  # type: ignore[arg-type]  # names of fields, as the caller spells them


def fill_database(engine: Engine) -> None:
    """Store a vehicle that ages, one with an alarm, one that is good, new fluid, and poison with markup."""
    worn = [fleet_result(seq, vehicle="worn", condition=Condition.CHANGE_FLUID) for seq in range(1, 5)]
    rows = [row_of(one) for one in (*history(60), *worn, fleet_result(1, vehicle="good.1"))]
    Writer(engine).store(
        Batch(
            shifts=rows,
            quarantined=[
                quarantine_row(
                    NOW,
                    topic="clutchdiag/v1/worn/shift",
                    vehicle="worn",
                    payload=MARKUP.encode(),
                    reason="schema",
                    detail=MARKUP,
                )
            ],
        )
    )
    queries.note_fill(engine, "car1", FLUID, at=datetime(2026, 1, 1, 0, 1, tzinfo=UTC), odometer_m=1.5e4, note=MARKUP)


def sources_of(engine: Engine, *, now: datetime = NOW) -> Sources:
    """Return what answers questions about a database, which was just read."""
    keeper = Keeper(DatabaseSource(engine))
    keeper.refresh()
    return Sources(engine=engine, keeper=keeper, now=lambda: now)


def asked(sources: Sources, *paths: str, mark: str = "") -> list[httpx.Response]:
    """Return what is answered at addresses, without a server; a page that is open tells the mark of what it shows."""
    site = application(sources, routes())

    async def answers() -> list[httpx.Response]:
        async with httpx.AsyncClient(transport=httpx.ASGITransport(site), base_url="http://127.0.0.1") as client:
            return [await client.get(path, headers={"if-none-match": mark}) for path in paths]

    with start_blocking_portal() as portal:
        return portal.call(answers)


def told(asked_of: Engine | Sources, path: str) -> Any:  # noqa: ANN401 - JSON
    """Return what a program is told at an address below /api/v1."""
    sources = asked_of if isinstance(asked_of, Sources) else sources_of(asked_of)
    (answer,) = asked(sources, f"/api/v1{path}")
    assert answer.status_code == 200, answer.text
    return answer.json()


def raise_alarms(engine: Engine) -> None:
    """Hold what is stored against the rules, two months later."""
    Watch(engine, Orders(), lambda: NOW).round(judging_s=HANG_S)


def filled(template: Path, folder: Path, *, has_alarms: bool = True) -> str:
    """Return the address of a database that is filled so, and of which alarms were raised."""
    path = folder / "fleet.sqlite"
    path.write_bytes(template.read_bytes())
    engine = open_database(f"sqlite:///{path}")
    fill_database(engine)
    if has_alarms:
        raise_alarms(engine)
    engine.dispose()
    return f"sqlite:///{path}"


@contextmanager
def served(database: str, access: Access | None = None, *, port: int = 0, now: datetime | None = None) -> Iterator[str]:
    """Serve the page of a database in a thread of its own, and yield its address without the last slash."""
    engine = open_database(database, must_exist=True, is_read_only=True)
    writer = open_database(database, must_exist=True)
    keeper = Keeper(DatabaseSource(engine))
    keeper.refresh()
    keeper.work_ahead(float("inf"))
    with closing_socket("127.0.0.1", port) as listener:
        clock, writes = (lambda: now or datetime.now(UTC)), writer if access else None
        sources = Sources(engine=engine, keeper=keeper, access=access or Access(), writer=writes, now=clock)
        server = server_of(sources)
        thread = threading.Thread(target=asyncio.run, args=(server.serve(sockets=[listener]),), name="fleet page")
        thread.start()
        try:
            yield address_of(listener).removesuffix("/")
        finally:
            server.should_exit = True
            thread.join(HANG_S)
            for one in (engine, writer):
                one.dispose()
