"""What a fleet page lists first, and when it is told of news."""

from collections.abc import AsyncIterator
from datetime import timedelta

from hypothesis import given
from hypothesis import strategies as st

from fleet_backend.page.fleet_view import SORTS, answer_of, vehicles_of
from fleet_backend.page.keeper import Keeper
from fleet_backend.page.listing import Wanted
from fleet_backend.page.news import News
from fleet_backend.page.records import ClutchNow
from fleet_tests.page.test_keeper import Fleet
from tests.support.fleet import NOW
from tests.support.fleet_page import clutch_now

ANY = Wanted()
CLUTCHES = st.builds(
    clutch_now,
    st.sampled_from(["car1", "car2", "Taxi.7", "_9"]),
    st.sampled_from([1, 2]),
    condition=st.sampled_from(["change_fluid", "watch", "good", "no_verdict"]),
    level_ratio=st.none() | st.floats(0.1, 1.5),
    odometer_m=st.none() | st.floats(0.0, 1e9),
    fluid=st.none() | st.sampled_from(["DCTF", "other"]),
    end_at=st.integers(0, 5).map(lambda days: NOW + timedelta(days=days)),
)
FLEETS = st.lists(CLUTCHES, max_size=8, unique_by=lambda one: (one.vehicle, one.clutch))


def by_vehicle(clutches: list[ClutchNow]) -> tuple[ClutchNow, ...]:
    return vehicles_of(
        {one.vehicle: tuple(each for each in clutches if each.vehicle == one.vehicle) for one in clutches}
    )


@given(FLEETS, st.sampled_from([None, *SORTS]), st.integers(1, 3))
def test_parts_in_every_order_are_the_whole(fleet: list[ClutchNow], sort: str | None, limit: int) -> None:
    vehicles = by_vehicle(fleet)
    whole = answer_of(vehicles, ANY, sort, None, 99)
    after, found = None, list[str]()
    for _ in range(len(vehicles) + 1):
        part = answer_of(vehicles, ANY, sort, after, limit)
        found += [one.vehicle for one in part.vehicles]
        after = part.next
        if after is None:
            break
    assert found == [one.vehicle for one in whole.vehicles]
    assert sorted(found) == sorted(one.vehicle for one in vehicles)
    assert sum(whole.counts.values()) == whole.matching_count == len(vehicles)
    if sort is not None and not sort.startswith("-"):
        assert found == [one.vehicle for one in answer_of(vehicles, ANY, f"-{sort}", None, 99).vehicles][::-1]


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
