"""The content of a report: results of one vehicle, from logs or a store, and the signals of two of its shifts."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

from canlog.logs import shown_name
from canlog.logs.reading import Watch
from clutch_model.calibration import Calibration, TorqueSource
from clutch_model.units import NS_PER_S
from clutch_results.clocks import NO_TODAY, Chronicle, chronicle_of
from clutch_results.event_kinds import DATED_NS, GEAR_CHANGES
from clutch_results.records import FluidFill, ShiftResult, Status, Tier, utc_from_bus_ns
from clutchdiag_io.people import NOT_SET
from diag_service.delivery import MemoryReporter
from diag_service.diagnosis.capability import AT_THE_CAR, need_lines
from diag_service.diagnosis.events import Event
from diag_service.diagnosis.summary import (
    Gap,
    Summary,
    latest_of,
    of_own_fluid,
    of_present_fluid,
    order_by,
    with_revisions,
)
from diag_service.errors import StoppedError
from diag_service.service.drive_survey import DriveSurvey
from diag_service.service.recorded import STOPPED_TEXT, run_recorded
from diag_service.service.session import versions_for
from diag_service.settings.config import DiagnosisConfig
from diag_service.settings.options import as_proposed
from diag_service.stopping import Trigger
from diag_service.store import Row, StoreReader, Versions
from fleet_contract import CLUTCHES
from fleet_contract.orders import Order, title_of

_NEEDED: Final = "friction needs "  # in the reason of a verdict, before the signals that it lacks
_SHOWN: Final = (Status.VALID, Status.REJECTED, Status.UNOBSERVED)


@dataclass(frozen=True, slots=True, kw_only=True)
class Example:
    """A shift with its signals."""

    event: Event
    result: ShiftResult


@dataclass(frozen=True, slots=True, kw_only=True)
class Findings:
    """Results of one vehicle in their order, all of the same versions, and where they are from."""

    vehicle: str
    sources: tuple[str, ...]
    rows: tuple[Row, ...]  # of logs numbered from 1
    latest: tuple[ShiftResult, ...]  # of each clutch, clutch 1 first; of a part of a drive without a verdict
    versions: Versions
    calibration: Calibration | None  # with which the results were made; None: another one than is at hand
    summary: Summary | None = None  # of the frames; a store keeps none
    fills: tuple[FluidFill, ...] = ()  # the earliest first
    examples: tuple[Example, ...] = ()  # one that was used and one that was not, if there were
    left_out_count: int = 0  # results of other versions
    today_ns: int = NO_TODAY  # when the findings were asked for, since 1970

    @property
    def results(self) -> tuple[ShiftResult, ...]:
        """The results by dates that can be believed."""
        return self._chronicle.results

    @property
    def _chronicle(self) -> Chronicle:
        return chronicle_of((row.result for row in self.rows), self.fills, self.today_ns)

    @property
    def is_dated(self) -> bool:
        return any(row.result.estimate.start_ns >= DATED_NS for row in self.rows)

    @property
    def order(self) -> Order:
        lockup = None if self.summary is None else self.summary.lockup
        fluid, doubts = self.fills[-1] if self.fills else None, self._chronicle.doubts
        return order_by(self.latest, fluid, self._elements, lockup, today_ns=self.today_ns, doubts=doubts)

    @property
    def untold(self) -> tuple[ShiftResult, ...]:
        """The results of a vehicle whose signals do not tell friction, by dates that can be believed; none: they do."""
        results = self.results
        if not results or results[-1].estimate.tier is Tier.FRICTION:
            return ()
        return tuple(result for result in results if result.estimate.tier is not Tier.FRICTION)

    @property
    def needs(self) -> tuple[str, ...]:
        """What friction would need, for people; a store knows no profile, and says it by signals alone."""
        if self.summary is not None:
            return tuple(need_lines(self.summary.capability))
        reasons = dict.fromkeys(result.verdict.reason.rpartition(_NEEDED)[-1] for result in self.latest if self.untold)
        return (*(f"{reason}." for reason in reasons), *((AT_THE_CAR,) if reasons else ()))

    @property
    def _elements(self) -> tuple[str, ...]:
        names = tuple(result.verdict.element for result in self.latest if result.verdict.element)
        return names if self.summary is None else self.summary.capability.elements  # of logs without an event, too

    @property
    def clutches(self) -> tuple[int, ...]:
        """The clutches of the vehicle: those with names of their own, or a pair."""
        return tuple(range(1, 1 + len(self._elements))) or CLUTCHES

    def title(self, clutch: int) -> str:
        """Return the name of a clutch at the beginning of a sentence."""
        return title_of(clutch, self._elements[clutch - 1] if self._elements else None)


class Album:
    """Keeps the shifts that are shown as pictures: the best that was used, and the worst that was not."""

    def __init__(self) -> None:
        self._kept: dict[Status, Example] = {}

    def offer(self, event: Event, result: ShiftResult) -> None:
        """Look at a shift; of those that are alike the first is kept."""
        best = self._kept.get(result.estimate.status)
        if best is None or _worth(result) > _worth(best.result):
            # samples of its own: those of the stream are written over
            columns = {signal: series.copy() for signal, series in event.columns.items()}
            self._kept[result.estimate.status] = Example(event=replace(event, columns=columns), result=result)

    @property
    def examples(self) -> tuple[Example, ...]:
        """Two at most; one that lacks signals is shown where none was rejected."""
        return tuple(self._kept[status] for status in _SHOWN if status in self._kept)[:2]


def findings_of_logs(
    config: DiagnosisConfig, paths: Sequence[Path], stop: Trigger, *, watch: Watch | None = None
) -> Findings:
    """Analyse the logs of a drive; ``watch`` hears how far the reading is.

    Raises what `analyze` raises, and StoppedError if it was stopped.
    """
    config = as_proposed(config, paths, lambda: stop.is_set)
    reporter, album = MemoryReporter(), Album()

    def look(event: Event) -> None:
        album.offer(event, reporter.results[-1])

    summary = run_recorded(config, paths, None, reporter, stop, watch=watch, survey=DriveSurvey, look=look).summary
    if Gap.STOPPED in summary.gaps:
        raise StoppedError(f"{STOPPED_TEXT}: no report was written")
    return Findings(
        vehicle=config.vehicle,
        sources=tuple(Path(shown_name(Path(log.path))).name for log in summary.contributions.logs),
        rows=tuple(
            Row(position=number, result=result) for number, result in enumerate(with_revisions(reporter.results), 1)
        ),
        latest=summary.latest,
        versions=versions_for(config.calibration),
        calibration=config.calibration,
        summary=summary,
        examples=album.examples,
        today_ns=summary.today_ns,
    )


def findings_of_store(path: Path, named: str | None, calibration: Calibration, today_ns: int) -> Findings:
    """Return what a store holds of a vehicle, by the versions of its newest result; dates are held against today.

    Raises StoreError if it is none, has no results of the vehicle that was named, or several vehicles and none was.
    """
    with StoreReader.open(path) as store:
        vehicle = store.vehicle(named)
        rows = list(store.rows(vehicle))
        fills = tuple(store.fills(vehicle))
    versions = _versions(rows[-1].result)
    same = [row for row in rows if _versions(row.result) == versions]
    revised, fluid = of_own_fluid(with_revisions(row.result for row in same), fills, today_ns), fills[-1:]
    return Findings(
        vehicle=vehicle,
        sources=(path.name,),
        rows=tuple(replace(row, result=result) for row, result in zip(same, revised, strict=True)),
        latest=of_present_fluid(
            latest_of((row.result for row in same), today_ns), fluid[0] if fluid else None, today_ns
        ),
        versions=versions,
        calibration=_made_with(versions, calibration),
        fills=fills,
        today_ns=today_ns,
        left_out_count=len(rows) - len(same),
    )


def findings_of_results(vehicle: str, results: Sequence[ShiftResult], calibration: Calibration) -> Findings:
    """Return what some results of a vehicle say, as all of them judge them; there must be one."""
    versions = _versions(results[-1])
    return Findings(
        vehicle=vehicle,
        sources=(),
        rows=tuple(Row(position=number, result=result) for number, result in enumerate(results, 1)),
        latest=latest_of(results),
        versions=versions,
        calibration=_made_with(versions, calibration),
    )


def _made_with(versions: Versions, calibration: Calibration) -> Calibration | None:
    """Return the calibration by which results were made; only the profile says where the torque comes from."""
    possible = (calibration, *map(calibration.with_torque, TorqueSource))
    return next(
        (possibility for possibility in possible if versions_for(possibility).calibration == versions.calibration), None
    )


def moment_words(t_ns: int, *, is_dated: bool = False) -> str:
    """Return a bus time for people: UTC, or the log's own seconds where no result ``is_dated``."""
    if t_ns >= DATED_NS:
        return utc_from_bus_ns(t_ns)[:19].replace("T", " ")
    return NOT_SET if is_dated else f"{t_ns / NS_PER_S:.1f} s"


def _versions(result: ShiftResult) -> Versions:
    return Versions(algorithm=result.algorithm_version, calibration=result.calibration_version)


def _worth(result: ShiftResult) -> float:
    estimate = result.estimate
    if estimate.status is Status.VALID:
        return estimate.fit.quality
    if estimate.status is Status.UNOBSERVED:
        return float(estimate.kind in GEAR_CHANGES)
    return -1.0 if estimate.data_quality is None else -estimate.data_quality.score
