"""What is kept of the fleet: what arrives is seen, what fails is tried again."""

from collections.abc import Sequence
from datetime import datetime, timedelta

from fleet_backend.ageing.prognosis import due_of
from fleet_backend.ageing.records import ClutchNow
from fleet_backend.errors import DatabaseAwayError
from fleet_backend.page.fleet import Keeper
from fleet_backend.page.queries import DatabaseSource
from fleet_backend.queries import PresentFluid, Row
from tests.support.fleet import NOW
from tests.support.fleet_page import clutch_now


class Fleet(DatabaseSource):
    """A fleet in memory; ``asked`` tells how it was read."""

    def __init__(self, *clutches: ClutchNow) -> None:
        self.clutches = list(clutches)
        self.news: list[str] = []
        self.at = NOW
        self.mark: tuple[object, ...] = (0, None, 0)
        self.filled: dict[str, PresentFluid] = {}
        self.asked: list[str] = []
        self.is_away = False

    def now(self) -> datetime:
        if self.is_away:
            raise DatabaseAwayError("database x: away")
        return self.at

    def fills_mark(self) -> tuple[object, ...]:
        return self.mark

    def alarmed(self) -> Sequence[str]:
        return ["a", "gone"]

    def dues(self, _since: datetime) -> Sequence[Row]:
        return []

    def fluids(self) -> dict[str, PresentFluid]:
        self.asked.append("fluids")
        return dict(self.filled)

    def all_clutches(self) -> Sequence[ClutchNow]:
        self.asked.append("all")
        return list(self.clutches)

    def clutches_of(self, vehicles: Sequence[str]) -> Sequence[ClutchNow]:
        self.asked.append(",".join(vehicles))
        return [one for one in self.clutches if one.vehicle in vehicles]

    def vehicles_with_news(self, since: datetime) -> Sequence[str]:
        assert since < self.at
        return self.news


def test_it_is_counted_who_is_due_silent_or_has_an_alarm() -> None:
    old = NOW - timedelta(days=15)
    keeper = Keeper(Fleet(clutch_now("a", action="change_now"), clutch_now("b", stored_at=old), clutch_now("c")))
    keeper.refresh()
    shown = keeper.snapshot
    assert [set(one) for one in (shown.due, shown.silent, shown.alarmed)] == [{"a"}, {"b"}, {"a"}]


def test_a_fluid_past_its_day_has_no_kilometres_left_and_not_less() -> None:
    late, today = clutch_now("a"), NOW.date()
    days = {"due_from": None, "half_by": late.end_at.date() - timedelta(days=9), "most_by": today, "least_left_m": 0.0}
    assert due_of(late, {**days, "distance_a_day_m": 4e4, "outlook": ""}, today).left_m == 0.0


def test_only_vehicles_with_news_are_read_again() -> None:
    fleet = Fleet(clutch_now("a"), clutch_now("b"))
    keeper = Keeper(fleet)
    assert keeper.refresh()
    fleet.clutches = [clutch_now("a"), clutch_now("b", condition="watch"), clutch_now("c")]
    fleet.news = ["b", "c"]
    assert keeper.refresh()
    assert fleet.asked == ["fluids", "all", "b,c"]
    assert [one.vehicle for one in keeper.snapshot.clutches] == ["b", "a", "c"]
    assert keeper.snapshot.number == 2
    assert not keeper.refresh()  # the same news again, within the overlap
    assert keeper.snapshot.number == 2


async def test_a_database_that_is_away_is_said_and_what_was_read_last_stays() -> None:
    fleet = Fleet(clutch_now("a"))
    keeper = Keeper(fleet)
    keeper.refresh()
    fleet.clutches, fleet.news = [clutch_now("a", seq=2)], ["a"]
    await keeper.look()
    fleet.is_away = True
    await keeper.look()
    assert keeper.complaint == "database x: away"
    assert (keeper.snapshot.number, keeper.snapshot.clutches[0].seq) == (2, 2)
    fleet.is_away = False
    await keeper.look()
    assert keeper.complaint is None
