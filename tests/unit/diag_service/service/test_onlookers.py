"""Who looks on: snapshots of a live run, metrics and health checks over HTTP, the screen of the monitor."""

import io
import math
import re
import urllib.error
import urllib.request
from collections.abc import AsyncIterator, Iterator
from dataclasses import replace

import pytest
from rich.console import Console

from canlog.e2e.e2e_state import E2eState
from canlog.frames import BusTrouble, FrameBatch
from canlog.live import BusState, BusStatus, SourceCounts
from clutch_model.calibration import nominal_calibration
from diag_service.commands.live import Monitor, spark_line
from diag_service.delivery import MemoryReporter
from diag_service.service.metrics import serving
from diag_service.service.session import Stage, Stuck
from diag_service.service.snapshot import STALE_S, Board, Snapshot, SnapshotTaker
from diag_service.settings.config import ListenAddress
from diag_service.store import ResultStore
from tests.support.histories import history
from tests.support.patience import HANG_S
from tests.unit.diag_service.service.test_live import gear_frames, session_for

STATUS = BusStatus(
    state=BusState.DEGRADED,
    errors={BusTrouble.ARBITRATION_LOST: 3},
    interruption_count=2,
    restart_count=1,
    last_problem="it went down",
)
FRAMES = 1_200  # three shifts and a bit
ANYWHERE = ListenAddress(host="127.0.0.1", port=0)


class StillSource:
    """A watched bus whose numbers a test sets."""

    description = "still"

    def __init__(self) -> None:
        self.counts = SourceCounts()
        self.status = STATUS
        self.bit_count = 0

    async def __aiter__(self) -> AsyncIterator[FrameBatch]:
        batches: tuple[FrameBatch, ...] = ()
        for batch in batches:
            yield batch

    async def aclose(self) -> None:
        """Nothing to stop."""


@pytest.fixture(name="snapshot", scope="module")
def _snapshot() -> Snapshot:
    """Return the snapshot of a run two seconds after its beginning: gears only, of every other message nothing."""
    source, store = StillSource(), ResultStore.in_memory()
    session = session_for(store, MemoryReporter())
    taker = SnapshotTaker(source, session, 100.0, 500_000)
    for event in session.stages.segment(gear_frames(3)):
        session.process(event)
    source.counts = SourceCounts(received=FRAMES, kernel_dropped=7)
    source.bit_count = 250_000
    early = taker.snapshot(100.1)
    assert early.load_ratio == 0.0
    taken = taker.snapshot(102.0)
    store.close()
    return taken


@pytest.fixture(name="board")
def _board(snapshot: Snapshot) -> Board:
    board = Board(lambda: 103.0)
    board.latest = snapshot
    return board


@pytest.fixture(name="url")
def _url(board: Board) -> Iterator[str]:
    with serving(ANYWHERE, board) as port:
        yield f"http://127.0.0.1:{port}"


def get(url: str) -> tuple[int, str]:
    try:
        with urllib.request.urlopen(url, timeout=HANG_S) as answer:  # noqa: S310 - our own server
            return answer.status, answer.read().decode()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, error.read().decode()


def test_a_snapshot_says_how_things_stand(snapshot: Snapshot) -> None:
    assert snapshot.rates_hz["TCU_Shift"] == FRAMES / 2.0
    assert snapshot.messages["TCU_Shift"].nominal_hz == 100.0
    assert snapshot.messages["TCU_Shift"].e2e_state is E2eState.VALID
    assert snapshot.load_ratio == pytest.approx(0.25)
    assert (snapshot.summary.frames.on_bus, snapshot.summary.frames.kernel_dropped) == (FRAMES + 7, 7)
    assert [result.seq for result in snapshot.recent] == [1, 2]
    assert snapshot.summary.shifts.by_status["rejected"] == 2


def test_health_follows_the_snapshot(snapshot: Snapshot) -> None:
    now_s = 0.0
    board = Board(lambda: now_s)
    with serving(ANYWHERE, board) as port:

        def codes() -> tuple[int, int]:
            return get(f"http://127.0.0.1:{port}/livez")[0], get(f"http://127.0.0.1:{port}/readyz")[0]

        assert get(f"http://127.0.0.1:{port}/metrics") == (200, "")
        assert codes() == (503, 503)
        board.latest = snapshot
        now_s = snapshot.taken_s + 1.0
        assert codes() == (200, 200)
        board.latest = replace(snapshot, bus=replace(STATUS, state=BusState.DOWN))
        assert codes() == (200, 503)
        board.latest = replace(snapshot, stuck=Stuck(stage=Stage.STORE, for_s=31.0))
        assert codes() == (503, 503)
        assert 'clutchdiag_stage_stuck_seconds{stage="store"} 31.0' in get(f"http://127.0.0.1:{port}/metrics")[1]
        board.latest = snapshot
        now_s = snapshot.taken_s + STALE_S
        assert codes() == (503, 503)
        assert get(f"http://127.0.0.1:{port}/elsewhere")[0] == 404


def test_a_monitor_shows_the_order_and_how_the_margin_of_each_clutch_went(snapshot: Snapshot) -> None:
    out = io.StringIO()
    told = [history(40)[number] for number in (0, 1, 38, 39)]
    with Monitor(Console(file=out, width=100), nominal_calibration()) as monitor:
        for one in told:
            monitor.report(one)
        monitor.show(snapshot)
    lines = out.getvalue().splitlines()
    order = lines.index(snapshot.summary.order.sentence)
    sparks = [line for line in lines if "friction margin" in line]
    assert [re.sub(r"[▁▂▃▄] -?\d+ %", "lower %", line) for line in sparks] == [
        "clutch 1 friction margin █lower % of new fluid",
        "clutch 2 friction margin █lower % of new fluid",
    ]
    assert order < lines.index(sparks[0])


def test_what_is_not_known_leaves_a_gap_in_a_sparkline() -> None:
    line = spark_line("clutch 1", [1.2, math.nan, 0.5, -0.3])
    assert line.plain == "clutch 1 friction margin █ ▅▁ -30 % of new fluid"
    assert spark_line("clutch 2", [math.nan]).plain.endswith("not known yet")
