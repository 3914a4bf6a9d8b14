"""``inspect --conversations``: what testers asked and controllers answered, in words and as JSON."""

import json
from collections.abc import AsyncIterator
from pathlib import Path

import pytest

import diag_service
from canlog.errors import SourceError
from canlog.frames import FrameBatch
from canlog.live import LinkBreak, SourceCounts
from canlog.logs import read_log
from diag_service.cli import main
from diag_service.commands.live import follow
from diag_service.errors import ConfigError
from diag_service.service.stopping import Trigger
from diag_service.tester.conversations import Conversations
from tests.support.pipes import piped

LINES = """
(1767225600.000000) can0 7E0#0322F190AAAAAAAA
(1767225600.010000) can0 7E8#037F2278AAAAAAAA
(1767225600.030000) can0 7E8#101462F190574657
(1767225600.031000) can0 7E0#3000000000000000
(1767225600.032000) can0 7E8#213030303132333435
(1767225600.033000) can0 7E8#2236373839303132
(1767225600.100000) can0 7E0#042E0100FF000000
(1767225600.112500) can0 7E8#037F2E3300000000
(1767225600.200000) can0 7DF#02010C0000000000
(1767225600.300000) can0 79B#022101FFFFFFFFFF
(1767225600.304000) can0 7BB#0461010203FFFFFF
(1767225600.400000) can0 7E8#101462F190574657
"""
TEXT = LINES.lstrip().replace("7E8#213030303132333435", "7E8#2130303031323334")


@pytest.fixture
def log(tmp_path: Path) -> Path:
    path = tmp_path / "workshop.log"
    path.write_text(TEXT)
    return path


def test_requests_and_answers_are_shown(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", str(log), "--conversations", "--pairs", "79B:7BB"]) == 0
    said = capsys.readouterr().out
    assert "iso tp: 8 whole messages, 1 incomplete (1 cut off)" in said
    assert "4 requests, 1 without an answer, 0 answers without a request" in said
    assert (
        "7E0 ReadDataByIdentifier: 22 F1 90 -> 7E8 62 F1 90 57 46 57 30 30 30 31 32 33 34 36 37 38 ... (20 bytes) "
        "after 30.0 ms, response pending 1 times"
    ) in said
    assert "7E0 WriteDataByIdentifier: 2E 01 00 FF -> 7E8 refused: security access denied (33) after 12.5 ms" in said
    assert "7DF current data: 01 0C -> no answer" in said
    assert "79B ReadDataByLocalIdentifier: 21 01 -> 7BB 61 01 02 03 after 4.0 ms" in said


def test_programs_get_them_whole(log: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", str(log), "--conversations", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["conversations"]
    assert told["incomplete"] == {"iso_tp": {"cut_off": 1}}
    first, second, third = told["exchanges"]
    assert first["answers"][0]["data"] == "62f19057465730303031323334363738393031" + "32"
    assert (first["pending"], first["latency_ms"], first["service"]) == (1, 30.0, "ReadDataByIdentifier")
    assert second["refusals"] == ["security access denied (33)"]
    assert third["latency_ms"] is None
    from_python = diag_service.inspect(log, has_conversations=True).conversations
    assert from_python is not None
    assert json.loads(json.dumps(from_python.record())) == told


@pytest.mark.parametrize("pairs", ["79B", "79B:XYZ", "FFF:700", ":"])
def test_pairs_that_are_none_are_refused(pairs: str, log: Path) -> None:
    with pytest.raises(ConfigError, match="say REQUEST:ANSWER in hexadecimal"):
        diag_service.inspect(log, pairs=pairs)


class Bus:
    """A bus on which a log is played frame by frame, and which then is away."""

    description = "a bus"
    counts = SourceCounts()

    def __init__(self, batch: FrameBatch, said: list[str]) -> None:
        self._batch = batch
        self._said = said

    async def __aiter__(self) -> AsyncIterator[FrameBatch | LinkBreak]:
        for row in range(len(self._batch)):
            self._said.append(f"frame {row}")
            yield self._batch[row : row + 1]
        yield LinkBreak(problem="cut")
        raise SourceError("it did not come back")

    async def aclose(self) -> None:
        """Nothing is open."""


async def test_conversations_of_a_bus_are_shown_as_they_come(tmp_path: Path) -> None:
    (tmp_path / "bus.log").write_text(f"{TEXT}(1767225601.100000) can0 123#\n(1767225606.000000) can0 123#\n", "ascii")
    (batch,) = read_log(tmp_path / "bus.log")
    said = list[str]()
    with pytest.raises(SourceError, match="did not come back"):
        await follow(Bus(batch, said), Conversations((), "79B:7BB"), Trigger(), said.append)
    told = [f"{line.split()[1]} {line.partition(': ')[2][:2]}" if " -> " in line else line for line in said]
    assert told.index("frame 6") < told.index("7E0 22") < told.index("frame 7")  # the next request came
    assert told.index("frame 12") < told.index("7E0 2E") < told.index("79B 21") < told.index("frame 13")
    assert told.index("frame 13") < told.index("7DF 01")
    assert sum("ReadDataByIdentifier: 22 F1 90 -> 7E8 62 F1 90" in line for line in said) == 1
    assert "the bus was lost: cut" in said
    assert "4 requests, 1 without an answer, 0 answers without a request in the log" in said


def test_conversations_of_a_pipe_are_shown_as_they_come(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with piped(monkeypatch, [TEXT.encode(), b"(1767225609.000000) can0 123#00\n"]):
        assert main(["inspect", "-", "--conversations"]) == 0
    said = capsys.readouterr().out
    assert said.index("22 F1 90 -> 7E8 62 F1 90") < said.index("frames, ") < said.index("3 requests, 1 without")
    assert said.count("22 F1 90 -> 7E8") == 1
