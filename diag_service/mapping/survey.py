"""What signals a log holds, with rates and ranges, and the profile proposed from them."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from pathlib import Path

import numpy as np
from cantools.database.can import Database

from canlog.database.addressing import why_wrong
from canlog.database.signal_columns import columns_database
from canlog.decode.codec import Codec
from canlog.logs import STANDARD_INPUT, read_log, shown_name, table_columns
from canlog.logs.reading import Watch
from canlog.logs.streams import never
from canlog.traffic import NS_PER_S
from clutchdiag_io.people import digits
from clutchdiag_io.program import legible
from dbc.contract import DBC_PATH
from diag_service.diagnosis.columns import Signal
from diag_service.errors import StoppedError
from diag_service.mapping import proposal
from diag_service.mapping.databases import open_database
from diag_service.mapping.decoder import Decoder
from diag_service.mapping.learning import VehicleSurvey
from diag_service.mapping.profile import Profile
from diag_service.mapping.tiers import PURPOSE, missing_for_next, tier_of


class Survey:
    """The messages and signals of a log, with rates and ranges."""

    def __init__(self, codec: Codec, *, are_columns: bool = False) -> None:
        self._codec = codec
        self._are_columns = are_columns
        self._counts: Counter[int] = Counter()  # by slot, as all here
        self._signals: dict[int, dict[str, proposal.SignalStatistics]] = {}
        self._ends_ns: list[int] = []  # first and last
        self._ids: set[int] = set()
        self.frames = 0
        self.is_cut = False
        self.notes: tuple[str, ...] = ()  # what the reader of the log says of it

    @property
    def unknown(self) -> int:
        return self.frames - self._counts.total()

    def add(self, path: Path, is_stopped: Callable[[], bool], watch: Watch | None = None, columns: str = "") -> None:
        """Count all frames of a log; raises StoppedError."""
        with closing(read_log(path, is_stopped=is_stopped, watch=watch, columns=columns)) as reader:
            for batch in reader:
                if is_stopped():
                    raise StoppedError("stopped early: no profile is proposed from a part of a log")
                ends_ns = [*self._ends_ns, int(batch.t_ns.min()), int(batch.t_ns.max())]
                self._ends_ns = [min(ends_ns), max(ends_ns)]
                self.frames += len(batch)
                self._ids.update(np.unique(batch.can_id).tolist())
                for found in self._codec.decode(batch):
                    self._counts[found.slot] += len(found.rows)
                    table, seen = self._codec.tables[found.slot], self._signals.setdefault(found.slot, {})
                    for name, decoded in found.signals.items():
                        unit = table.definitions[name].unit or ""
                        fresh = proposal.SignalStatistics(
                            message=table.message.name, signal=name, unit=unit, is_column=self._are_columns
                        )
                        seen.setdefault(name, fresh).add(decoded)
        self.is_cut, self.notes = reader.counts.truncated, tuple(reader.counts.notes)

    @property
    def why_wrong(self) -> str:
        """Why the database is probably that of another bus; empty if it may be the right one."""
        known = sum(map(self._codec.knows, self._ids))
        return why_wrong(known, len(self._ids), len(self._counts), len(self._codec.tables))

    def statistics(self) -> list[proposal.SignalStatistics]:
        return [one for _, seen in sorted(self._signals.items()) for _, one in sorted(seen.items())]

    def listing(self) -> Iterator[str]:
        """Yield a line for each message that came, with its rate, and one for each of its signals, with its range."""
        first_ns, last_ns = self._ends_ns or (0, 0)
        duration_s = (last_ns - first_ns) / NS_PER_S
        for slot, count in sorted(self._counts.items()):
            message = self._codec.tables[slot].message
            rate_hz = (count - 1) / duration_s if duration_s else 0.0
            name, unit = f"{message.name} ({message.frame_id:#x})", "frames"
            if self._are_columns:
                name, unit = message.name, "values"
            yield f"{name}: {count} {unit}, {rate_hz:.1f} Hz"
            for _, one in sorted(self._signals[slot].items()):
                span = f"{digits(one.lowest)} to {digits(one.highest)} {one.unit}".rstrip() if one.count else "no value"
                lost = {reason.replace("_", " "): count for reason, count in one.invalid._asdict().items() if count}
                called = "" if self._are_columns else f"{one.signal}: "
                yield f"  {called}{span}{''.join(f', {count} values {reason}' for reason, count in lost.items())}"


def proposed_profile(
    log: Path,
    dbc: Path | None = None,
    is_stopped: Callable[[], bool] = never,
    *,
    watch: Watch | None = None,
    columns: str = "",
) -> str:
    """Return a profile, as the text of a TOML file, whose comments say what signals the log holds."""
    named = () if dbc is not None else table_columns(log, is_stopped=is_stopped, columns=columns)
    are_columns, meant = bool(named), "its columns" if named else (dbc or DBC_PATH).name
    database = columns_database(named) if named else open_database(dbc)
    survey = Survey(Codec(database.messages, check_codes=True), are_columns=are_columns)
    survey.add(log, is_stopped, watch, columns)
    name, stem = (shown_name(log), "piped") if log == STANDARD_INPUT else (log.name, log.stem)
    best = proposal.candidates(survey.statistics())
    over, ratios = _shown_ratios(log, database, best, columns)
    knows_gears = proposal.is_complete(ratios)
    tier = tier_of(best.keys(), knows_gears=knows_gears)
    reach = f"tier {tier:d} ({PURPOSE[tier]})" if tier else "no tier"
    remarks = [
        f"Proposed for {name} and {meant} by names, units and values: check every line.",
        f"As it stands it reaches {reach}. {missing_for_next(best.keys(), knows_gears=knows_gears)}",
        "",
        *(["The log is cut off."] if survey.is_cut else []),
        *(f"The log: {note}." for note in survey.notes),
        f"{survey.frames} frames, {survey.unknown} of them not in the database.",
        *([f"It is {why}."] if (why := survey.why_wrong) else []),
        *proposal.unfit_units(survey.statistics(), best),
        *survey.listing(),
        "",
    ]
    signals = proposal.profile_text(legible(stem), best, [legible(remark) for remark in remarks])
    return signals + proposal.gears_text(over, ratios)


def _shown_ratios(
    log: Path, database: Database, best: Mapping[Signal, Sequence[proposal.Candidate]], columns: str
) -> tuple[Signal, Mapping[int, proposal.GearRatio]]:
    """Return over which speed a log shows the ratios of which gears; none where they are not needed."""
    over = next((one for one in (Signal.OUTPUT_SPEED, Signal.VEHICLE_SPEED) if one in best), None)
    knows_slip = tier_of(best.keys()) is not None and best.keys() & {Signal.INPUT1_SPEED, Signal.INPUT_SPEED}
    if log == STANDARD_INPUT or over is None or knows_slip:
        return Signal.OUTPUT_SPEED, {}
    profile = Profile(name="proposed", sources={signal: found[0].source for signal, found in best.items()})
    decoder, survey = Decoder(database, profile), VehicleSurvey(over)
    with closing(read_log(log, columns=columns)) as reader:
        for one in decoder.whole(reader):
            survey.add(one)
    learned = survey.learned()
    return over, {gear: one.ratio for gear, one in learned.gears.items() if learned.are_named}
