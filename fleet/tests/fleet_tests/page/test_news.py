"""When a page is told of news."""

from collections.abc import AsyncIterator

from fleet_backend.page.fleet import Keeper
from fleet_backend.page.news import News
from fleet_tests.page.test_keeper import Fleet
from tests.support.fleet_page import clutch_now


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
