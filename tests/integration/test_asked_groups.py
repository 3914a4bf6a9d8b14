"""Parameter groups of J1939 that are asked for: before a transmission that is not ours, that of can-j1939."""

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count, pairwise
from pathlib import Path

import can
import j1939
import pytest

from diag_service.diagnosis.columns import Signal
from diag_service.mapping.interpretation import interpret
from diag_service.mapping.profile import load_profile
from tests.integration.test_signal_asking import Ear, heard, wait_for
from tests.plugins.asked_services import SentByUs
from tests.support.asked import batch_of
from workshop.tester.addresses import GROUP_REQUEST
from workshop.tester.can_line import line_on
from workshop.tester.signal_asking import GROUP_S, PollPlan, SignalAsker

pytestmark = pytest.mark.asks

TRF1 = 65272
TOLD = [25, 0xFF, 0xFF, 0xFF, 0x20, 0x2C, 0xFF, 0xFF]  # 400 kPa, 80 degC
REQUEST_ID = 0x18EAFFF9
NUMBERS = count()


@contextmanager
def transmission(channel: str) -> Iterator[None]:
    """Put a transmission on a bus that tells pressure and temperature to whoever asks."""
    with can.Bus(channel, "virtual") as bus:
        unit = j1939.ElectronicControlUnit(
            send_message=lambda can_id, _long, data, _fd=None: bus.send(
                can.Message(arbitration_id=can_id, is_extended_id=True, data=bytes(data))
            )
        )
        name = j1939.Name(
            arbitrary_address_capable=0, industry_group=0, vehicle_system_instance=0, vehicle_system=0, function=3,
            function_instance=0, ecu_instance=0, manufacturer_code=666, identity_number=1,
        )  # fmt: skip
        application = j1939.ControllerApplication(name, 3, bypass_address_claim=True)
        unit.add_ca(controller_application=application)
        application.subscribe_request(
            lambda _source, _to, pgn: application.send_pgn(0, 0xFE, 0xF8, 6, TOLD) if pgn == TRF1 else None
        )
        application.start()
        listener = lambda message: unit.notify(message.arbitration_id, message.data, message.timestamp)  # noqa: E731
        try:
            with can.Notifier(bus, [listener], timeout=0.05):
                yield
        finally:
            unit.stop()


@contextmanager
def asked(channel: str) -> Iterator[SignalAsker]:
    with can.Bus(channel, "virtual") as bus:
        asker = SignalAsker(
            {},
            load_profile().asking,
            lambda: line_on(bus, [], [TRF1], is_fd=False, listen_s=0.05, goes_on=lambda: asker.goes_on),
            groups=[TRF1],
        )
        with asker:
            yield asker


def requests(ear: Ear) -> list[can.Message]:
    return [one for one in list(ear.frames) if one.arbitration_id == REQUEST_ID]


@pytest.fixture(name="channel")
def _channel() -> str:
    return f"groups {next(NUMBERS)}"


def test_a_group_is_asked_for_no_more_than_twice_a_second() -> None:
    plan, moments_s = PollPlan({}, load_profile().asking, [TRF1]), [100.0 + 0.01 * step for step in range(1000)]
    asked_s = [now_s for now_s in moments_s if plan.due(now_s)]
    assert len(asked_s) == 20
    assert all(after - before > 0.99 * GROUP_S for before, after in pairwise(asked_s))


def test_the_answers_of_a_group_are_signals(channel: str, sent_by_us: SentByUs) -> None:
    with transmission(channel), heard(channel) as ear, asked(channel) as asker:
        wait_for(lambda: asker.set_count >= 3 and len(requests(ear)) >= 3)
        assert set(asker.sent) == {GROUP_REQUEST}
    assert set(sent_by_us.services) == {GROUP_REQUEST}
    decoder = interpret(None, Path("j1939")).decoder()
    told = [batch.columns for batch in decoder.feed(batch_of(ear.frames))]
    assert decoder.groups == (TRF1,)
    assert {float(one[Signal.CLUTCH1_PRESSURE].value[0]) for one in told} == {4e5}
    assert {float(one[Signal.SUMP_TEMPERATURE].value[0]) for one in told} == {353.15}
