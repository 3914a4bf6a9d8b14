"""What is kept of the fleet: what arrives is seen, what fails is tried again, who listens hears of changes alone."""

from collections.abc import Sequence
from datetime import datetime

from fleet_backend.errors import DatabaseAwayError
from fleet_backend.page.keeper import Keeper
from fleet_backend.page.records import ClutchNow
from fleet_backend.page.running import DatabaseSource, FillsSeen
from fleet_backend.queries import PresentFluid
from tests.support.fleet import NOW
from tests.support.fleet_page import clutch_now


class Fleet(DatabaseSource):
    """A fleet in memory; ``asked`` tells how it was read."""

    def __init__(self, *clutches: ClutchNow) -> None:
        self.clutches = list(clutches)
        self.news: list[str] = []
        self.at = NOW
        self.fills = FillsSeen(count=0, latest=None)
        self.filled: dict[str, PresentFluid] = {}
        self.asked: list[str] = []
        self.is_away = False

    def now(self) -> datetime:
        if self.is_away:
            raise DatabaseAwayError("database x: away")
        return self.at

    def fills_seen(self) -> FillsSeen:
        return self.fills

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


def test_only_vehicles_with_news_are_read_again() -> None:
    fleet = Fleet(clutch_now("a"), clutch_now("b"))
    keeper = Keeper(fleet)
    assert keeper.refresh()
    fleet.clutches = [clutch_now("a"), clutch_now("b", condition="watch"), clutch_now("c")]
    fleet.news = ["b", "c"]
    assert keeper.refresh()
    assert fleet.asked == ["fluids", "all", "b,c"]
    assert [one.vehicle for one in keeper.snapshot.clutches] == ["b", "a", "c"]
    assert (keeper.snapshot.number, keeper.snapshot.changed) == (2, frozenset({"b", "c"}))
    assert not keeper.refresh()  # the same news again, within the overlap
    assert keeper.snapshot.number == 2


async def test_who_listens_hears_of_changes_and_a_database_that_is_away_is_said() -> None:
    fleet = Fleet(clutch_now("a"))
    keeper = Keeper(fleet)
    keeper.refresh()
    heard: list[int] = []
    leave = keeper.listen(lambda snapshot: heard.append(snapshot.number))
    fleet.clutches, fleet.news = [clutch_now("a", seq=2)], ["a"]
    await keeper.look()
    fleet.is_away = True
    await keeper.look()
    assert keeper.complaint == "database x: away"
    assert keeper.snapshot.clutches[0].seq == 2
    fleet.is_away = False
    await keeper.look()
    assert keeper.complaint is None
    leave()
    fleet.clutches = [clutch_now("a", seq=3)]
    await keeper.look()
    assert (keeper.snapshot.number, heard) == (3, [2])
