"""A controller under any requests, test results, trips, waits and restarts: what ISO 14229-1 always wants."""

import tempfile
from pathlib import Path

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from tests.support.uds.full_table import full_table
from tests.support.uds.pdx_client import MORE, PARKED
from workshop.controller import server
from workshop.controller.controller import MemoryFile
from workshop.controller.iso14229 import CLEARED, DEFAULT_SESSION, DtcStatus, Nrc
from workshop.controller.memory import FAILED_COUNTER, PASSED_COUNTER, TestResult
from workshop.controller.services.sessions import key_of
from workshop.controller.state import Instant, Request

CODES = st.sampled_from([0x081107, 0x278800, 0x27874B])
SEED = bytes(range(1, 17))
SILENT_TO_ALL = {0x11, 0x12, 0x31, 0x7E, 0x7F}  # refusals that a request to all does not get
SENSIBLE = st.sampled_from([
    "1001", "1003", "1040", "1101", "14ffffff", "1902ff", "1904081107ff", "1906081107ff", "190a", "22f190", "22f186",
    "220105", "2701", "2703", "28 00 01", "2c01f31001030102", "2c03", "2ef198434c555443",
    "310103010404", "31030301", "31010302", "3e00", "3e80", "8501", "8502",
]).map(bytes.fromhex)  # fmt: skip
REQUESTS = st.one_of(
    SENSIBLE,
    st.binary(min_size=1, max_size=40),
    st.builds(lambda request, end, more: request[: end + 1] + more, SENSIBLE, st.integers(0, 8), st.binary(max_size=4)),
)


class Diagnosis(RuleBasedStateMachine):
    """One controller, parked, with a file for what outlives a restart."""

    @initialize()
    def begin(self) -> None:
        self.folder = tempfile.TemporaryDirectory()
        self.table, self.t_s = full_table(), 100.0
        self.state = server.switched_on(self.table, None, self.t_s)

    @property
    def moment(self) -> Instant:
        return Instant(t_s=self.t_s, values={**PARKED, **MORE}, chance=SEED)

    def ask(self, payload: bytes, *, is_functional: bool = False) -> bytes | None:
        reply = server.answer(
            self.table, self.state, Request(payload=payload, is_functional=is_functional), self.moment
        )
        self.state = reply.state
        return reply.payload

    @rule(payload=REQUESTS, is_functional=st.booleans())
    def request(self, payload: bytes, *, is_functional: bool) -> None:
        sleeps = self.t_s < self.state.asleep_until_s  # after a reset
        response = self.ask(payload, is_functional=is_functional)
        if response is None:
            assert sleeps or is_functional or len(payload) > 1  # a single byte has no bit that suppresses the response
        elif response[0] == 0x7F:
            assert (len(response), response[1]) == (3, payload[0])
            assert Nrc(response[2])
            assert not (is_functional and response[2] in SILENT_TO_ALL)
        else:
            assert response[0] == payload[0] + 0x40

    @rule(level=st.sampled_from([1, 3]), is_right=st.booleans())
    def unlock(self, level: int, *, is_right: bool) -> None:
        response, before = self.ask(bytes([0x27, level])), self.state.unlocked
        if response is not None and response[0] == 0x67 and any(response[2:]):
            key = key_of(self.table.levels[level], response[2:])
            wrong = bytes([key[0] ^ 1]) + key[1:]
            told = self.ask(bytes([0x27, level + 1]) + (key if is_right else wrong))
            assert (told is not None and told[0] == 0x67) == is_right
            assert self.state.unlocked == (level if is_right else before)

    @rule(code=CODES, result=st.sampled_from(TestResult))
    def sample(self, code: int, result: TestResult) -> None:
        was_updated = self.state.are_codes_updated
        self.state = server.tested(self.table, self.state, code, result, self.moment)
        if was_updated and result in {TestResult.FAILED, TestResult.PASSED}:
            status = self.state.memory.records[code].status
            assert bool(status & DtcStatus.TEST_FAILED) == (result is TestResult.FAILED)

    @rule(code=CODES, is_warm=st.booleans(), count=st.sampled_from([1, 1, 3, 44]))
    def good_drives(self, code: int, *, is_warm: bool, count: int) -> None:
        for _ in range(count):
            self.state = server.warmed_up(self.state) if is_warm else self.state
            self.state = server.tested(self.table, self.state, code, TestResult.PASSED, self.moment)
            self.state = server.cycled(self.table, self.state)
        assert not self.state.memory.records[code].status & (DtcStatus.TEST_FAILED | DtcStatus.FAILED_THIS_CYCLE)

    @rule(duration_s=st.sampled_from([0.01, 1.0, 6.0]))
    def wait(self, duration_s: float) -> None:
        self.t_s += duration_s
        self.state = server.advance(self.table, self.state, self.moment).state

    @rule()
    def leave_alone(self) -> None:
        """Hear nothing for longer than S3: the session ends, and with it what was unlocked."""
        for _ in range(3):
            self.wait(60.0)
        assert (self.state.session, self.state.unlocked) == (DEFAULT_SESSION, 0)

    @rule()
    def restart(self) -> None:
        """Take the current away, and give it again: codes and written data are in the file, a session is not."""
        path = Path(self.folder.name) / "memory.json"
        with MemoryFile(path, self.table) as store:
            store.save(self.state)
        with MemoryFile(path, self.table) as store:
            again = server.switched_on(self.table, store.load(), self.t_s)
        assert again.written == self.state.written
        assert {code for code, one in again.memory.records.items() if one.status & DtcStatus.CONFIRMED} == {
            code for code, one in self.state.memory.records.items() if one.status & DtcStatus.CONFIRMED
        }
        assert (again.session, again.unlocked) == (DEFAULT_SESSION, 0)
        self.state = again

    @rule()
    def clear(self) -> None:
        if self.ask(b"\x14\xff\xff\xff") == b"\x54":
            assert {one.status for one in self.state.memory.records.values()} == {CLEARED}

    @invariant()
    def codes_do_not_contradict_themselves(self) -> None:
        if not hasattr(self, "state"):
            return
        assert self.state.session in self.table.sessions
        assert self.state.session != DEFAULT_SESSION or not self.state.unlocked
        for one in self.state.memory.records.values():
            assert PASSED_COUNTER <= one.detection_counter <= FAILED_COUNTER
            if one.status & DtcStatus.FAILED_THIS_CYCLE:
                assert one.status & DtcStatus.PENDING
                assert one.status & DtcStatus.FAILED_SINCE_CLEAR
                assert not one.status & DtcStatus.NOT_TESTED_THIS_CYCLE
            if one.status & DtcStatus.NOT_TESTED_SINCE_CLEAR:
                assert not one.status & (DtcStatus.TEST_FAILED | DtcStatus.PENDING | DtcStatus.CONFIRMED)

    def teardown(self) -> None:
        if hasattr(self, "folder"):
            self.folder.cleanup()


Diagnosis.TestCase.settings = settings(max_examples=60, stateful_step_count=40)
TestDiagnosis = Diagnosis.TestCase
