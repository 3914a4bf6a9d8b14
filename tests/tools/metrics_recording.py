"""Records what the metrics endpoint serves while the fluid of an emulated car turns bad.

``python -m tests.tools.metrics_recording`` drives the scenario "ageing" in memory, asks the endpoint after every third
shift as Prometheus does, and writes the answers into ``tests/data``; a minute. The tests of dashboards and alert rules
evaluate this recording: make it anew when metrics change.
"""

import argparse
import lzma
import sys
import urllib.request
from collections.abc import AsyncIterator, Iterator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from canlog.frames import FrameBatch
from canlog.live import BusState, BusStatus, SourceCounts
from clutch_model.calibration import nominal_calibration
from clutch_results.records import FluidFill, utc_from_bus_ns
from dbc.contract import load_contract
from diag_service.delivery import MemoryReporter
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.profile import load_profile
from diag_service.service.metrics import serving
from diag_service.service.session import Session
from diag_service.service.snapshot import Board, SnapshotTaker
from diag_service.settings.config import DiagnosisConfig, ListenAddress
from diag_service.store import ResultStore
from ecu_emulator.drive.recording import frames_of
from ecu_emulator.scenario.scenario_file import load_scenario
from studies.builders import to_batch
from tests.support.patience import HANG_S
from tests.support.prometheus import RECORDING

SCENARIO: Final = "ageing"
VEHICLE: Final = "car1"
ASKED_EVERY: Final = 3  # shifts
BITRATE: Final = 500_000
BITS_PER_FRAME: Final = 125.0
SLICE_FRAMES: Final = 1_000
NS_PER_S: Final = 1e9
ACCEPTED: Final = "application/openmetrics-text; version=1.0.0"
UP: Final = BusStatus(state=BusState.UP, errors={}, interruption_count=0, restart_count=0, last_problem=None)


@dataclass(slots=True)
class HeardBus:
    """A bus of which so many frames have been heard."""

    received: int = 0
    description: str = SCENARIO
    status: BusStatus = UP

    @property
    def counts(self) -> SourceCounts:
        return SourceCounts(received=self.received)

    @property
    def bit_count(self) -> float:
        return BITS_PER_FRAME * self.received

    async def __aiter__(self) -> AsyncIterator[FrameBatch]:
        batches: tuple[FrameBatch, ...] = ()
        for batch in batches:
            yield batch

    async def aclose(self) -> None:
        """Nothing to stop."""


def scrapes() -> Iterator[str]:
    """Yield what the endpoint answers after every third shift of the drive."""
    frames, _ = frames_of(load_scenario(SCENARIO))
    batch = to_batch(frames)
    begin_ns = int(batch.t_ns[0])
    now_ns, bus = begin_ns, HeardBus()
    config = DiagnosisConfig(vehicle=VEHICLE, calibration=nominal_calibration())
    with closing(ResultStore.in_memory()) as store:
        store.add_fills([FluidFill(vehicle=VEHICLE, filled_at=utc_from_bus_ns(begin_ns), product="DCTF 75W")])
        session = Session(
            config,
            Decoder(load_contract(), load_profile()),
            store,
            None,
            MemoryReporter(),
            utc_now=lambda: utc_from_bus_ns(now_ns),
        )
        taker, board, count = SnapshotTaker(bus, session, 0.0, BITRATE), Board(), 0
        with serving(ListenAddress(host="127.0.0.1", port=0), board) as port:
            for first in range(0, len(batch), SLICE_FRAMES):
                part = batch[slice(first, first + SLICE_FRAMES)]
                bus.received, now_ns = bus.received + len(part), int(part.t_ns[-1])
                for event in session.stages.segment(part):
                    session.process(event)
                    count += 1
                    if count % ASKED_EVERY == 0:
                        board.latest = taker.snapshot((now_ns - begin_ns) / NS_PER_S)
                        yield scrape(port)


def scrape(port: int) -> str:
    """Return what the endpoint answers to Prometheus."""
    request = urllib.request.Request(f"http://127.0.0.1:{port}/metrics", headers={"Accept": ACCEPTED})
    with urllib.request.urlopen(request, timeout=HANG_S) as answer:  # noqa: S310 - our own server
        return str(answer.read().decode())


def main() -> int:
    """Write the recording."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=RECORDING)
    arguments = parser.parse_args()
    found = list(scrapes())
    arguments.output.write_bytes(lzma.compress("".join(found).encode(), preset=9))
    print(f"{len(found)} scrapes, {arguments.output.stat().st_size / 1024:.0f} KiB: {arguments.output}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
