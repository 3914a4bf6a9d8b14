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


async def test_on_a_bus_with_times_of_its_own_it_has_the_last_one_heard() -> None:
    assert await heard_s("own times", [7.0, 0.0, 8.5, 0.0]) == [7.0, 7.0, 8.5, 8.5]


@pytest.mark.parametrize(("last_s", "is_told"), [(7.0, True), (7.001, False)])
async def test_times_that_stand_still_are_told_once(
    caplog: pytest.LogCaptureFixture, last_s: float, *, is_told: bool
) -> None:
    await heard_s(f"still until {last_s}", [*[7.0] * (pythoncan.MANY_FRAMES - 1), last_s, *[7.0] * 5])
    text = (
        f"still until {last_s}: its first 1,000 frames all have the same time, so nothing can be found in them: "
        "the sender has to give each its own time, or none"
    )
    assert [record.getMessage() for record in caplog.records] == [text] * is_told


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
