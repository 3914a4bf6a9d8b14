"""Who looks on: snapshots of a live run, metrics and health checks over HTTP, the screen of the monitor."""

import io
import re
import socket
import urllib.error
import urllib.request
from collections.abc import AsyncIterator, Iterator
from dataclasses import replace

import pytest
from prometheus_client.parser import text_string_to_metric_families
from rich.console import Console

from canlog.e2e.e2e_state import E2eState
from canlog.frames import BusTrouble, FrameBatch
from canlog.live import BusState, BusStatus, SourceCounts
from diag_service.delivery import MemoryReporter
from diag_service.diagnosis.condition.verdict import Cause, advice
from diag_service.diagnosis.records import Condition, ShiftQuality
from diag_service.errors import ConfigError
from diag_service.service.bus_run import Monitor, screen
from diag_service.service.metrics import families, serving
from diag_service.service.session import Stage, Stuck
from diag_service.service.snapshot import SILENT_S, STALE_S, Board, RateMeter, Snapshot, SnapshotTaker
from diag_service.settings.config import ListenAddress, parse_listen_address
from diag_service.store import ResultStore
from tests.support.builders import shift_result
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
    early = taker.take(100.1)
    assert early.load_ratio == 0.0
    taken = taker.take(102.0)
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


def test_rates_are_those_of_the_frames_heard_however_they_were_cut() -> None:
    meter, begin_ns = RateMeter(10.0, 500_000), 10**18
    shown = []
    for half_s, heard_s in enumerate(
        (0.4, 0.9, 1.9, 1.9, 2.4, 3.4, 3.4, 3.9)
    ):  # frames come when they were kept enough
        count = round(100 * heard_s)
        meter.measure(10.0 + half_s / 2, begin_ns + count * 10_000_000, {"TCU_Shift": count}, 1_000 * count)
        shown.append((meter.rates_hz.get("TCU_Shift"), meter.load_ratio))
    assert shown[:2] == [(None, 0.0)] * 2
    assert [rate for rate, _ in shown[4:]] == [pytest.approx(100.0)] * 4
    assert shown[-1][1] == pytest.approx(0.2)


def test_a_silent_bus_has_no_rate_and_a_jump_of_bus_time_none_of_its_own() -> None:
    meter, begin_ns = RateMeter(0.0, 500_000), 10**18
    meter.measure(1.0, begin_ns, {"TCU_Shift": 100}, 0)
    meter.measure(1.0 + SILENT_S / 2, begin_ns, {"TCU_Shift": 100}, 0)
    assert meter.rates_hz == {"TCU_Shift": 100.0}
    meter.measure(1.0 + SILENT_S, begin_ns, {"TCU_Shift": 100}, 0)
    assert meter.rates_hz == {"TCU_Shift": 0.0}
    meter.measure(3.0 + SILENT_S, begin_ns + 10**15, {"TCU_Shift": 300}, 0)
    assert meter.rates_hz == {"TCU_Shift": 100.0}
    meter.measure(5.0 + SILENT_S, begin_ns, {"TCU_Shift": 500}, 0)
    assert meter.rates_hz == {"TCU_Shift": 100.0}


def test_metrics_carry_the_snapshot(url: str) -> None:
    status, text = get(f"{url}/metrics")
    assert status == 200
    samples = {
        (sample.name, *sorted(sample.labels.values())): sample.value
        for family in text_string_to_metric_families(text)
        for sample in family.samples
    }
    assert samples["clutchdiag_bus_state", "degraded"] == 1.0
    assert samples["clutchdiag_bus_state", "up"] == 0.0
    assert samples["clutchdiag_bus_load_ratio",] == pytest.approx(0.25)
    assert samples["clutchdiag_bus_errors_total", "arbitration_lost"] == 3.0
    assert samples["clutchdiag_bus_interruptions_total",] == 2.0
    assert samples["clutchdiag_frames_on_bus_total",] == FRAMES + 7
    assert samples["clutchdiag_frames_total", "decoded"] == FRAMES
    assert samples["clutchdiag_frames_total", "kernel_dropped"] == 7.0
    assert samples["clutchdiag_message_rate_hertz", "TCU_Shift"] == FRAMES / 2.0
    assert samples["clutchdiag_message_nominal_hertz", "IC_Odometer"] == 1.0
    assert samples["clutchdiag_message_e2e_state", "TCU_Shift", "valid"] == 1.0
    assert samples["clutchdiag_message_e2e_state", "TCU_Output", "no_data"] == 1.0
    assert samples["clutchdiag_message_invalidations_total", "TCU_Shift"] == 0.0
    assert samples["clutchdiag_shifts_total", "rejected"] == 2.0
    assert samples["clutchdiag_shift_reasons_total", "signal_missing"] == 2.0
    assert samples["clutchdiag_last_shift_trust",] == 0.0


def test_the_score_of_the_last_gear_change_is_told(snapshot: Snapshot) -> None:
    def told(*qualities: ShiftQuality | None) -> list[float]:
        results = [shift_result(seq) for seq in range(len(qualities))]
        recent = tuple(
            replace(result, estimate=replace(result.estimate, shift_quality=quality))
            for result, quality in zip(results, qualities, strict=True)
        )
        found = families(replace(snapshot, recent=recent))
        return [one.value for family in found if family.name == "clutchdiag_last_shift_score" for one in family.samples]

    assert told(ShiftQuality(score=20.0), ShiftQuality(score=80.0), ShiftQuality(score=None), None) == [80.0]
    assert told(ShiftQuality(score=None)) == told(None) == told() == []


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


def test_a_client_that_says_nothing_holds_up_nobody(url: str) -> None:
    host, port = url.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port)), timeout=HANG_S):
        assert get(f"{url}/livez") == (200, "OK\n")


def test_an_address_in_use_is_one_clear_line(url: str, board: Board) -> None:
    address = parse_listen_address(url.removeprefix("http://"))
    with pytest.raises(ConfigError, match=r"cannot serve metrics on 127\.0\.0\.1:"), serving(address, board):
        raise AssertionError("two servers on one port")


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [("9464", "127.0.0.1", 9464), ("0.0.0.0:1", "0.0.0.0", 1), ("[::1]:80", "::1", 80), (":8000", "127.0.0.1", 8000)],  # noqa: S104 - parsed only
)
def test_addresses(text: str, host: str, port: int) -> None:
    assert parse_listen_address(text) == ListenAddress(host=host, port=port)


@pytest.mark.parametrize("text", ["", "host", "host:", "host:name", "1:70000", "-1"])
def test_addresses_that_are_none(text: str) -> None:
    with pytest.raises(ConfigError, match="HOST"):
        parse_listen_address(text)


def test_the_screen_shows_everything(snapshot: Snapshot) -> None:
    out = io.StringIO()
    with Monitor(Console(file=out, width=160)) as monitor:
        monitor.show(snapshot)
    text = out.getvalue()
    assert "car1  bus degraded  load 25.0 %  interrupted 2 times" in text
    assert "3 arbitration lost" in text
    assert "last problem: it went down" in text
    rows = {line.split()[0]: line.split() for line in text.splitlines() if line.strip()}
    assert rows["TCU_Shift"][1:] == ["600.0", "100.0", "valid", str(FRAMES), "0", "0", "0"]
    assert rows["IC_Odometer"][1:5] == ["0.0", "1.0", "no", "data"]
    assert rows["2"][:5] == ["2", "2-1", "shift", "1", "rejected"]
    assert "signal missing" in text


def test_news_between_two_pictures_show_nothing(snapshot: Snapshot, capsys: pytest.CaptureFixture[str]) -> None:
    out = io.StringIO()
    monitor = Monitor(Console(file=out))
    for news in ("vcan0", snapshot.recent[0], snapshot.summary):
        monitor.report(news)
    assert (out.getvalue(), *capsys.readouterr()) == ("", "", "")


def test_the_screen_fits_eighty_columns_whatever_messages_are_called(snapshot: Snapshot) -> None:
    name, counts = next(iter(snapshot.messages.items()))
    long_name = "A_message_that_somebody_gave_a_name_of_more_than_forty_letters"
    busy = replace(counts, decoded=123_456_789, missing=1_234_567)
    wide = replace(
        snapshot,
        messages={**snapshot.messages, long_name: busy},
        rates_hz={**snapshot.rates_hz, long_name: 1_000.0, name: 100.0},
    )
    console = Console(file=io.StringIO(), width=80, force_terminal=False)
    console.print(screen(wide, (80, 24), "q ends this"))
    assert isinstance(console.file, io.StringIO)
    lines = console.file.getvalue().splitlines()
    assert max(map(len, lines)) <= 80
    assert any("123456789" in line and "1234567" in line for line in lines)
    assert lines[-1].strip() == "q ends this"
    shifts = [line for line in lines if re.match(r" +\d+  \d-\d +[a-z]", line)]
    assert len(shifts) == 2


def screen_lines(snapshot: Snapshot, width: int, height: int) -> list[str]:
    out = io.StringIO()
    Console(file=out, width=width, force_terminal=False).print(screen(snapshot, (width, height), "q ends this"))
    return out.getvalue().splitlines()


def test_the_screen_says_what_to_do_and_still_fits_eighty_columns(snapshot: Snapshot) -> None:
    text = advice(2, Condition.WATCH, Cause.MARGIN_THIN, 0.24)
    assert len(text) > 100
    worn = shift_result(1)
    worn = replace(worn, verdict=replace(worn.verdict, advice=text, condition=Condition.WATCH))
    statistics = replace(snapshot.summary.shifts, latest={2: worn})
    shown = replace(snapshot, summary=replace(snapshot.summary, shifts=statistics))
    lines = screen_lines(shown, 80, 24)
    assert max(map(len, lines)) <= 80
    assert len(lines) <= 24
    words = " ".join(" ".join(lines[:10]).split())
    assert text not in words
    assert words.count("Have the fluid changed at the next service.") == 1
    wide = screen_lines(shown, 200, 50)
    assert [line.strip() for line in wide].count(text) == 1
