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


async def heard(stream: AsyncIterator[str]) -> str:
    """Return the next message that says something."""
    while (told := await anext(stream)).startswith(":"):
        pass
    return told


async def test_several_changes_are_heard_of_as_one_and_others_not_at_all() -> None:
    fleet, keeper = a_fleet()
    news = News(keeper, period_s=0.0)
    whole, of_b, late = news.stream(1, None), news.stream(1, "b"), news.stream(0, "b")
    assert [await heard(one) for one in (whole, of_b)] == ["retry: 3000\n\n"] * 2
    assert [await heard(late), await heard(late)] == ["retry: 3000\n\n", "id: 1\nevent: news\ndata: 1\n\n"]
    assert await anext(of_b) == ": still here\n\n"
    await drive(fleet, keeper, "a", 2)
    await drive(fleet, keeper, "a", 3)
    assert await heard(whole) == "id: 3\nevent: news\ndata: 3\n\n"
    assert await anext(of_b) == ": still here\n\n"
    await drive(fleet, keeper, "b", 2)
    assert await heard(of_b) == "id: 4\nevent: news\ndata: 4\n\n"
    assert await heard(whole) == "id: 4\nevent: news\ndata: 4\n\n"
    news.end()
    assert [[one async for one in stream] for stream in (whole, of_b)] == [[], []]
