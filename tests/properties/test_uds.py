"""The diagnosis against a second one from the standard's prose, and against clients that know nothing."""

import tempfile
from pathlib import Path
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule

from tests.support.uds.clients import RESULTS, RandomClient, step
from tests.support.uds.pair import Pair
from tests.support.uds.server_by_the_book import table

CODES = st.sampled_from([0x081107, 0x278800, 0x27874B])
CHANCE = st.binary(min_size=16, max_size=16).filter(lambda data: any(data[:4]))


class TroubleCodes(RuleBasedStateMachine):
    """Results, cycles, clears and restarts in any order."""

    @initialize()
    def begin(self) -> None:
        self.folder = tempfile.TemporaryDirectory()
        self.pair = Pair(Path(self.folder.name))

    @rule(code=CODES, result=st.sampled_from(RESULTS))
    def sample(self, code: int, result: str) -> None:
        self.pair.sample(code, result)

    @rule(code=CODES, is_warm=st.booleans(), count=st.sampled_from([1, 1, 1, 2, 3, 44]))
    def good_drives(self, code: int, *, is_warm: bool, count: int) -> None:
        for _ in range(count):
            if is_warm:
                self.pair.warm_up()
            self.pair.sample(code, "passed")
            self.pair.cycle()

    @rule()
    def cycle(self) -> None:
        self.pair.cycle()

    @rule()
    def restart(self) -> None:
        self.pair.restart()

    @rule(code=st.one_of(CODES, st.just(0xFFFFFF)))
    def clear(self, code: int) -> None:
        self.pair.ask(b"\x14" + code.to_bytes(3, "big"), bytes(16))

    @rule(is_on=st.booleans())
    def switch(self, *, is_on: bool) -> None:
        self.pair.ask(b"\x10\x03", bytes(16))
        self.pair.ask(b"\x85\x01" if is_on else b"\x85\x02", bytes(16))

    @rule(code=CODES, report=st.sampled_from([b"\x04", b"\x06"]))
    def read(self, code: int, report: bytes) -> None:
        self.pair.ask(b"\x19" + report + code.to_bytes(3, "big") + b"\xff", bytes(16))

    def teardown(self) -> None:
        if hasattr(self, "folder"):
            self.folder.cleanup()


TroubleCodes.TestCase.settings = settings(max_examples=25, stateful_step_count=30)
TestTroubleCodes = TroubleCodes.TestCase


@settings(max_examples=40)
@given(seed=st.integers(0, 2**32))
def test_random_clients_are_answered_as_the_model_says(seed: int, tmp_path_factory: pytest.TempPathFactory) -> None:
    pair = Pair(tmp_path_factory.mktemp("pair", numbered=True))
    client = RandomClient(
        Random(seed),  # noqa: S311 - to be repeated
        table(),
        list(pair.model.troubles),
    )
    for _ in range(60):
        step(pair, client)


@settings(max_examples=100)
@given(requests=st.lists(st.binary(min_size=1, max_size=40), min_size=1, max_size=20), chance=CHANCE)
def test_whatever_is_asked_is_answered(
    requests: list[bytes], chance: bytes, tmp_path_factory: pytest.TempPathFactory
) -> None:
    pair = Pair(tmp_path_factory.mktemp("pair", numbered=True))
    for request in requests:
        pair.ask(request, chance)
