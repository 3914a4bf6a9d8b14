"""One question at a time: patience, late answers, a controller that is busy, sessions and locks."""

import time
from collections import deque
from collections.abc import Sequence

import pytest

from diag_service.errors import PendingError, RefusedError, StoppedError
from diag_service.tester.answers import Timing
from diag_service.tester.dialogue import Dialogue
from diag_service.tester.libraries import BaseConnection, TimeoutException

QUICK = Timing(p2_s=0.02, p2_star_s=0.05, longest_s=0.2, gap_s=0.0)
VIN = bytes.fromhex("22 F1 90")
ANSWER = bytes.fromhex("62 F1 90 41")


class Scripted(BaseConnection):
    """A controller that has an answer, or several, ready for each request in turn; one that is left out is silence."""

    def __init__(self, *turns: Sequence[str]) -> None:
        super().__init__("scripted")
        self.turns = deque(turns)
        self.asked: list[str] = []
        self.coming: deque[bytes] = deque()

    def open(self) -> "Scripted":
        return self

    def close(self) -> None: ...

    def is_open(self) -> bool:
        return True

    def empty_rxqueue(self) -> None: ...

    def empty_txqueue(self) -> None: ...

    def specific_send(self, payload: bytes, timeout: float | None = None) -> None:
        del timeout
        self.asked.append(payload.hex(" "))
        self.coming.extend(map(bytes.fromhex, self.turns.popleft() if self.turns else ()))

    def specific_wait_frame(self, timeout: float | None = None) -> bytes:
        if not self.coming:
            time.sleep(timeout or 0.0)
            raise TimeoutException
        return self.coming.popleft()


def dialogue_of(*turns: Sequence[str]) -> tuple[Dialogue, Scripted, list[float]]:
    pauses: list[float] = []
    connection = Scripted(*turns)
    return Dialogue(connection, "7E1", QUICK, pause=pauses.append), connection, pauses


def test_a_controller_that_asks_for_patience_gets_it() -> None:
    tester, _, _ = dialogue_of(["7f 22 78", "7f 22 78", "62 f1 90 41"])
    assert tester.ask(VIN) == ANSWER
    assert tester.counts.requests == 1


def test_patience_ends() -> None:
    tester = Dialogue(Endless("7f 22 78"), "7E1", Timing(p2_s=0.01, p2_star_s=0.01, longest_s=0.05, most_silent=1))
    with pytest.raises(PendingError, match=r"^7E1 asked for more time \d+ times in 0 s and never answered 22 F1 90$"):
        tester.ask(VIN)


def test_who_shall_stop_does_not_wait_for_a_busy_controller() -> None:
    looks = iter([True, True, False])
    tester = Dialogue(Scripted(*[["7f 22 21"]] * 9), "7E1", Timing(busy_pause_s=60.0), goes_on=lambda: next(looks))
    with pytest.raises(StoppedError, match="not everything was asked"):
        tester.ask(VIN)


class Endless(Scripted):
    """A controller that says the same for ever."""

    def __init__(self, answer: str) -> None:
        super().__init__()
        self.answer = bytes.fromhex(answer)

    def specific_wait_frame(self, timeout: float | None = None) -> bytes:
        if not timeout:
            raise TimeoutException
        time.sleep(0.001)
        return self.answer


def test_a_busy_controller_is_asked_again_after_longer_and_longer_pauses() -> None:
    tester, _, pauses = dialogue_of(["7f 22 21"], ["7f 22 21"], ["62 f1 90 41"])
    assert tester.ask(VIN) == ANSWER
    assert pauses == [0.1, 0.2]
    assert (tester.counts.requests, tester.counts.busy) == (3, 2)


def test_late_answers_to_others_are_passed_over() -> None:
    tester, _, _ = dialogue_of(["62 f1 87 00", "7f 19 31", "6e f1 90", "62 f1 90 41"])
    assert tester.ask(VIN) == ANSWER
    assert tester.counts.stray == 3


def test_what_is_not_answered_is_asked_once_more() -> None:
    tester, connection, _ = dialogue_of([], ["62 f1 90 41"])
    assert tester.ask(VIN) == ANSWER
    assert connection.asked == ["22 f1 90"] * 2
    assert tester.counts.silent == 1


def test_a_refusal_says_what_was_asked_and_why() -> None:
    tester, _, _ = dialogue_of(["7f 31 88"])
    with pytest.raises(RefusedError, match=r"^7E1 refuses 31 01 03 01: vehicle speed too high \(88\)$"):
        tester.ask(bytes.fromhex("31 01 03 01"))


def test_a_session_is_left_whatever_happens_in_it() -> None:
    tester, connection, _ = dialogue_of(["50 03 00 32 01 f4"], ["7f 31 22"], ["50 01 00 32 01 f4"])
    with pytest.raises(RefusedError), tester.session(3):
        tester.ask(bytes.fromhex("31 01 03 01"))
    assert connection.asked == ["10 03", "31 01 03 01", "10 01"]
