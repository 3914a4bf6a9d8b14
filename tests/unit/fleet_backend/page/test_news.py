"""Who looks at a page hears of what is new: at once, once, and until the server ends."""

import asyncio
from collections.abc import AsyncIterator

import pytest

from fleet_backend.page.errors import BusyError
from fleet_backend.page.keeper import Keeper
from fleet_backend.page.news import MOST_READERS, News
from tests.support.fleet_page import clutch_now
from tests.unit.fleet_backend.page.test_keeper import Fleet


def a_fleet() -> tuple[Fleet, Keeper]:
    fleet = Fleet(clutch_now("a"), clutch_now("b"))
    keeper = Keeper(fleet)
    keeper.refresh()
    return fleet, keeper


async def drive(fleet: Fleet, keeper: Keeper, vehicle: str, seq: int) -> None:
    fleet.clutches = [clutch_now(vehicle, seq=seq) if one.vehicle == vehicle else one for one in fleet.clutches]
    fleet.news = [vehicle]
    await keeper.look()


async def begun(stream: AsyncIterator[str]) -> AsyncIterator[str]:
    assert (await anext(stream)).startswith("retry: ")
    return stream


async def test_several_changes_are_heard_of_as_one_and_others_not_at_all() -> None:
    fleet, keeper = a_fleet()
    news = News(keeper, rest_s=0.0)
    whole, of_b = await begun(news.stream(1, None)), await begun(news.stream(1, "b"))
    await drive(fleet, keeper, "a", 2)
    await drive(fleet, keeper, "a", 3)
    assert await anext(whole) == "id: 3\nevent: news\ndata: 3\n\n"
    await drive(fleet, keeper, "b", 2)
    assert await anext(of_b) == "id: 4\nevent: news\ndata: 4\n\n"
    assert await anext(whole) == "id: 4\nevent: news\ndata: 4\n\n"
    news.end()
    assert [one async for one in whole] == []
    assert [one async for one in of_b] == []


async def test_who_knows_an_older_state_hears_at_once_and_silence_has_a_heartbeat() -> None:
    _, keeper = a_fleet()
    late = await begun(News(keeper).stream(0, None))
    assert await anext(late) == "id: 1\nevent: news\ndata: 1\n\n"
    idle = await begun(News(keeper, heartbeat_s=0.001).stream(1, None))
    assert await anext(idle) == ": still here\n\n"


async def test_there_is_an_end_to_readers() -> None:
    _, keeper = a_fleet()
    news = News(keeper)
    readers = [await begun(news.stream(1, None)) for _ in range(MOST_READERS)]
    with pytest.raises(BusyError, match="500 readers"):
        news.stream(1, None)
    await asyncio.gather(*(one.aclose() for one in readers))  # type: ignore[attr-defined]  # a generator has it
    await begun(news.stream(1, None))


async def test_a_page_rests_between_two_renewals() -> None:
    fleet, keeper = a_fleet()
    news, clock = News(keeper, rest_s=0.05), asyncio.get_running_loop().time
    began_s, stream = clock(), await begun(news.stream(1, None))
    heard: list[str] = []
    for seq in (2, 3):
        await drive(fleet, keeper, "a", seq)
        heard.append(await anext(stream))
    assert heard == ["id: 2\nevent: news\ndata: 2\n\n", "id: 3\nevent: news\ndata: 3\n\n"]
    assert clock() - began_s >= 0.1
    long_rest = await begun(News(keeper, rest_s=1000.0).stream(1, None))
    assert await anext(long_rest) == "id: 3\nevent: news\ndata: 3\n\n"  # it knew an older state
