"""How long a controller is waited for."""

from types import SimpleNamespace
from unittest.mock import Mock

import pytest

from workshop.tester import can_line
from workshop.tester.addresses import CanAddress
from workshop.tester.can_line import CanLine
from workshop.tester.dialogue import TimeoutException

GEARBOX = CanAddress(request_id=0x7E1, response_id=0x7E9)
REQUEST, ANSWER = bytes.fromhex("22100C"), bytes.fromhex("62100C17")
PENDING, OF_ANOTHER = bytes.fromhex("7F2278"), bytes.fromhex("7E00")
STEP_S = 0.1


def asked(monkeypatch: pytest.MonkeyPatch, frames: list[bytes]) -> tuple[bytes | None, float]:
    """Return what a line takes as the answer among frames, one each 0.1 s and the last for ever; and after what time.

    Time is what the frames take.
    """
    clock = SimpleNamespace(now_s=0.0)

    def wait_frame(timeout_s: float) -> bytes:
        clock.now_s += min(STEP_S, timeout_s)
        if timeout_s < STEP_S:
            raise TimeoutException
        return frames.pop(0) if len(frames) > 1 else frames[0]

    monkeypatch.setattr(can_line, "CanConnection", lambda *_, **__: Mock(specific_wait_frame=wait_frame))
    monkeypatch.setattr(can_line, "time", SimpleNamespace(monotonic=lambda: clock.now_s))
    line = CanLine(Mock(), is_fd=False, goes_on=lambda: True)
    return line.ask(REQUEST, GEARBOX), clock.now_s


def test_what_others_are_told_does_not_prolong_the_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    answer, took_s = asked(monkeypatch, [OF_ANOTHER])
    assert answer is None
    assert took_s < 0.5


def test_who_asks_for_patience_gets_it_but_not_for_ever(monkeypatch: pytest.MonkeyPatch) -> None:
    assert asked(monkeypatch, [*[PENDING] * 20, OF_ANOTHER, ANSWER])[0] == ANSWER
    answer, took_s = asked(monkeypatch, [PENDING])
    assert answer == PENDING
    assert 29.0 < took_s < 31.0
