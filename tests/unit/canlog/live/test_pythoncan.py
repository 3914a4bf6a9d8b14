"""A bus of python-can that falls silent: told where its times are those of this machine, and nowhere else."""

import asyncio
import time
from collections.abc import Sequence

import can
import pytest

from canlog.live import Silence, pythoncan
from canlog.live.pythoncan import PythonCanSource
from tests.support.patience import HANG_S

SILENCE_S = 0.2


def message_at(time_s: float) -> can.Message:
    return can.Message(arbitration_id=0x123, is_extended_id=False, data=b"\x01", timestamp=time_s)


async def heard_s(channel: str, times_s: Sequence[float]) -> list[float]:
    """Return the times with which frames are heard that are sent with these times; 0 is none."""
    with can.Bus(channel, interface="virtual", preserve_timestamps=True) as near:
        source = PythonCanSource(can.Bus(channel, interface="virtual"), channel)
        found: list[float] = []
        for time_s in times_s:
            near.send(message_at(time_s))
        async with asyncio.timeout(HANG_S):
            async for part in source:
                found += [] if isinstance(part, Silence) else (part.t_ns / 1e9).tolist()
                if len(found) == len(times_s):
                    await source.aclose()
    return found


async def test_a_frame_without_a_time_has_that_of_its_receipt() -> None:
    """A program that forwards frames as new messages gives none, and a virtual bus may keep what it was given."""
    before_s = time.time()
    found = await heard_s("no times", [0.0] * 5)
    assert before_s - 1e-5 <= found[0] <= found[-1] <= time.time()
    assert found == sorted(found)


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
