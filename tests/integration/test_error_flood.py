"""A bus out of order floods the service with error frames: they cost it next to nothing, and it ends when told."""

import asyncio
import re
import signal
import struct
from pathlib import Path

import can
import numpy as np
import pytest

from canlog.frames import ERROR_FLAG, count_errors
from canlog.live.pythoncan import PythonCanSource
from canlog.live.sources import BusSilence
from dbc.contract import load_contract
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from tests.integration.test_service_onlookers import fetch
from tests.support.batches import frames_at
from tests.support.beside import Beside
from tests.support.bus_end import raw_socket
from tests.support.service import service
from tests.support.wire import START_NS

FLOOD = 3_000
BUS_OFF, NO_ACKNOWLEDGE = 0x40, 0x20


@pytest.mark.parametrize("kind", [BUS_OFF, NO_ACKNOWLEDGE])
def test_a_flood_of_error_frames_is_no_more_work_than_its_batches(kind: int) -> None:
    """Each stretch that the decoder cuts costs as much as hundreds of frames; the flood is one."""

    async def cut() -> tuple[int, int, int]:
        decoder, channel = Decoder(load_contract(), load_profile()), f"flood{kind}"
        with can.Bus(channel, "virtual") as sender:
            source = PythonCanSource(can.Bus(channel, "virtual"), channel)
            for _ in range(FLOOD):
                sender.send(can.Message(arbitration_id=kind, is_error_frame=True))
            while source.counts.received < FLOOD:  # noqa: ASYNC110 - another thread counts
                await asyncio.sleep(0)
            await source.aclose()  # as a signal does it: what has come is handed over still
            batches = [part async for part in source if not isinstance(part, BusSilence)]
        stretches = sum(len(decoder.feed(batch)) for batch in batches)
        told = sum((count_errors(batch).total() for batch in batches), 0)
        return stretches, len(batches), told

    stretches, batch_count, told = asyncio.run(cut())
    assert told == FLOOD
    assert stretches <= batch_count


def test_frames_between_two_losses_of_the_bus_are_a_stretch_of_their_own() -> None:
    decoder = Decoder(load_contract(), load_profile())
    off = ERROR_FLAG | BUS_OFF
    batch = frames_at(START_NS + np.arange(9) * 1_000_000, [0x7FF, off, off, 0x7FF, 0x7FF, off, off, 0x7FF, off])
    found = decoder.feed(batch)
    assert [part.breaks_before for part in found] == [False, True, True, True]
    assert [part.watermark_ns for part in found] == [START_NS + row * 1_000_000 for row in (0, 4, 7, 8)]


HEARD, MORE = 20_000, 1_000_000  # error frames: before the service is stopped, and within which it has ended
PACKED = struct.Struct("=IB3x8s")


class Flood(Beside):
    """Error frames as fast as a vcan takes them, while entered or until so many are sent."""

    def __init__(self, channel: str, kind: int) -> None:
        super().__init__()
        self._channel, self._frame = channel, PACKED.pack(ERROR_FLAG | kind, 8, bytes(8))
        self.left = 2**62

    def _work(self) -> None:
        with raw_socket(self._channel) as raw:
            while self.left > 0 and not self._is_over.is_set():
                raw.send(self._frame)
                self.left -= 1


@pytest.mark.vcan
def test_a_service_that_is_flooded_ends_when_it_is_told(vcan: str, tmp_path: Path) -> None:
    arguments = ("run", "-i", "socketcan", "-c", vcan, "--metrics", "0", "--store", tmp_path / "car.sqlite", "--json")
    heard = re.compile(r"^clutchdiag_bus_errors_total\{[^}]*\} (\S+)$", re.MULTILINE)
    with service(tmp_path / "service", *arguments) as running:
        running.wait_for(lambda: "metrics on" in running.err)
        with Flood(vcan, NO_ACKNOWLEDGE):
            running.wait_for(lambda: sum(map(float, heard.findall(fetch(running, "/metrics")))) > HEARD)
            assert fetch(running, "/livez") == fetch(running, "/readyz") == "OK\n"
        with Flood(vcan, BUS_OFF) as flood:
            running.wait_for(lambda: "bus-off" in running.err)
            assert fetch(running, "/livez") == "OK\n"
            flood.left = MORE
            running.send(signal.SIGTERM)
            ended = running.wait()
            assert flood.left > 0
    assert ended.status == 0, ended.err
