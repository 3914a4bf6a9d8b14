"""The poller: how often it asks, what it makes of a controller that does not answer, what it stores and tells."""

import logging
import threading
from contextlib import closing

import pytest

from diag_service.delivery import MemoryReporter
from diag_service.errors import SilentError
from diag_service.store import ResultStore
from diag_service.tester.polling import ControllerReport, Poller, message_of, pause_s, publish_controller
from diag_service.tester.trouble import Snapshot, TroubleCode
from fleet_contract import Channel, Outgoing, read_message
from tests.support.patience import HANG_S


def report(*codes: TroubleCode, read_at: str = "2026-01-01T00:00:00.000000Z") -> ControllerReport:
    return ControllerReport(
        vehicle="car1", read_at=read_at, controller="7E1 (answers 7E9)", description="TCU", codes=codes
    )


def code(status: int, *snapshots: Snapshot) -> TroubleCode:
    return TroubleCode(number=0x089700, status=status, text="Transmission Fluid Deteriorated", snapshots=snapshots)


def test_a_controller_that_fails_is_asked_less_and_less_often() -> None:
    assert [pause_s(60.0, count) for count in (0, 1, 2, 3, 4, 5, 5000)] == [60, 120, 240, 480, 960, 960, 960]


def test_it_asks_again_after_a_failure_and_says_so_once(caplog: pytest.LogCaptureFixture) -> None:
    is_told = threading.Event()
    answers: list[ControllerReport | SilentError] = [SilentError("silent"), SilentError("silent"), report()]

    def read() -> ControllerReport:
        answer = answers.pop(0) if len(answers) > 1 else answers[0]
        if isinstance(answer, SilentError):
            raise answer
        return answer

    told: list[ControllerReport] = []

    def tell(said: ControllerReport) -> None:
        told.append(said)
        is_told.set()

    caplog.set_level(logging.INFO, logger="diag_service")
    with Poller(read, tell, 0.001):
        assert is_told.wait(HANG_S)
    assert len(answers) == 1
    assert told[0] == report()
    assert [record.getMessage() for record in caplog.records] == [
        "the trouble codes were not read: silent; trying again, less and less often",
        "the controller answers again",
    ]


def test_what_is_new_is_stored_and_told_and_all_is_published() -> None:
    reporter, published = MemoryReporter(), list[Outgoing]()
    with closing(ResultStore.in_memory()) as store:
        for number, said in enumerate((report(), report(code(0x04)), report(code(0x04)), report(code(0x08)))):
            later = f"2026-01-01T00:00:0{number}.000000Z"
            publish_controller(report(*said.codes, read_at=later), store, reporter, published.append)
        kept = store.controller_reports("car1")
    assert [str(one) for one in reporter.controllers] == [
        "controller 7E1 (answers 7E9): no trouble codes",
        "controller 7E1 (answers 7E9): P0897 Transmission Fluid Deteriorated (pending)",
        "controller 7E1 (answers 7E9): P0897 Transmission Fluid Deteriorated (confirmed)",
    ]
    assert len(kept) == 3
    assert len(published) == 4
    assert published[0].is_retained
    read = read_message(published[-1].topic, published[-1].payload)
    assert read.data["produced_at"] == "2026-01-01T00:00:03.000000Z"


@pytest.mark.parametrize("count", [1, 600, 3000])
def test_a_message_fits_the_contract_whatever_a_controller_says(count: int) -> None:
    long = Snapshot(number=1, data={"datum": {f"field {number}": "x" * 50 for number in range(20)}})
    codes = [TroubleCode(number=number << 8, status=0x0A, text="t" * 40, snapshots=(long,)) for number in range(count)]
    message = message_of(report(*codes).record)
    assert len(message.payload) <= Channel.CONTROLLER.max_bytes
    data = read_message(message.topic, message.payload).data
    assert isinstance(data["codes"], list)
    assert len(data["codes"]) == min(count, len(data["codes"]))
    assert len(data["codes"]) > 0
