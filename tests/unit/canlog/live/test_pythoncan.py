"""A bus of python-can that falls silent: told where its times are those of this machine, and nowhere else."""

import asyncio
import time

import can
import pytest

from canlog.live import Silence, pythoncan
from canlog.live.pythoncan import PythonCanSource
from tests.support.patience import HANG_S

SILENCE_S = 0.2


async def _close_later(source: PythonCanSource) -> None:
    await asyncio.sleep(5.0 * SILENCE_S)
    await source.aclose()


@pytest.mark.parametrize(("is_of_now", "expected"), [(True, ["frames", "silence"]), (False, ["frames"])])
async def test_silence_is_told_once_where_times_are_of_this_machine(
    monkeypatch: pytest.MonkeyPatch, expected: list[str], *, is_of_now: bool
) -> None:
    monkeypatch.setattr(pythoncan, "SILENCE_S", SILENCE_S)
    monkeypatch.setattr(pythoncan, "NOW_S", HANG_S)
    channel = f"silence-{is_of_now}"
    timestamp = time.time() if is_of_now else 1.0
    heard: list[str] = []
    with can.Bus(channel, interface="virtual", preserve_timestamps=True) as near:
        source = PythonCanSource(can.Bus(channel, interface="virtual"), channel)
        near.send(can.Message(arbitration_id=0x123, is_extended_id=False, data=b"\x01", timestamp=timestamp))
        async with asyncio.timeout(HANG_S), asyncio.TaskGroup() as tasks:
            async for part in source:
                heard.append("silence" if isinstance(part, Silence) else "frames")
                if heard == expected:
                    tasks.create_task(_close_later(source))
    assert heard == expected
