"""Recorded drives from Python: ``analyze``, what it returns, and its picture."""

import logging
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Unpack

from canlog.column_files import arrow_schema, row_table
from canlog.errors import NOTICE, OutputError
from canlog.extras import load_extra
from canlog.files import is_folder
from canlog.logs.reading import Watch
from clutch_model.calibration import Calibration
from clutch_results.pictures import LIMITS, Fan
from clutch_results.records import ClutchVerdict, ShiftResult, dump, shift_record, verdict_from
from clutchdiag_io.people import PLUS_MINUS
from clutchdiag_io.program import legible
from diag_service.api.choices import AnyPath, AnyPaths, Delivery, LogMeaning, named, optional_path, path_list, sent_to
from diag_service.batch.tables import check_output, columns, drive_rows, flattened, record_columns, write_results
from diag_service.batch.worker import drive_entry
from diag_service.console import collected_notices
from diag_service.delivery import AllReporters, MemoryReporter, Reporter
from diag_service.delivery.console import condition_words
from diag_service.diagnosis.friction.paper import PaperCollection, PaperShift, PooledClutch, nominal_driveline
from diag_service.diagnosis.summary import Gap, summary_record, unjudged, with_revisions
from diag_service.errors import ConfigError
from diag_service.service.drive import check_complete, open_drive
from diag_service.service.drive_survey import DriveSurvey
from diag_service.service.recorded import Account, replay, run_recorded
from diag_service.service.stages import Stages
from diag_service.settings.options import AnalyzeOptions, as_proposed, check_replaceable, diagnosis_config
from diag_service.stopping import Controls
from fleet_contract import Channel
from fleet_contract.orders import name_of

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LOG = logging.getLogger(__name__)
Row = Mapping[str, object]


class ResultTable:
    """Rows with named, typed columns; nested keys of a record are joined by dots, lists by semicolons.

    It is a sequence of rows, each a mapping from column to value, None where there is none. Libraries that know the
    Arrow interface take it as it is: ``pyarrow.table(table)``, ``polars.DataFrame(table)``, DuckDB.

    Attributes
    ----------
    types : Mapping of str to str
        The type of each column as Arrow names it, in the order of the columns. Names end in the SI unit of the values.
    """

    def __init__(self, types: Mapping[str, str], rows: Sequence[Row]) -> None:
        self.types = dict(types)
        self._rows = [{name: row.get(name) for name in self.types} for row in rows]

    @property
    def columns(self) -> tuple[str, ...]:
        """The names of the columns."""
        return tuple(self.types)

    def __len__(self) -> int:
        return len(self._rows)

    def __getitem__(self, number: int) -> Row:
        return self._rows[number]

    def __iter__(self) -> Iterator[Row]:
        return iter(self._rows)

    def column(self, name: str) -> list[object]:
        """Return one column; raises KeyError if there is none of this name."""
        if name not in self.types:
            raise KeyError(name)
        return [row[name] for row in self._rows]

    def to_arrow(self) -> Any:  # noqa: ANN401 - an untyped library
        """Return a ``pyarrow.Table``; ExtraMissingError if pyarrow is not installed."""
        return row_table(self._rows, arrow_schema(self.types))

    def to_pandas(self) -> Any:  # noqa: ANN401 - optional
        """Return a DataFrame of pandas; ExtraMissingError if pandas or pyarrow is not installed."""
        load_extra("pandas", "to_pandas() needs pandas")
        return self.to_arrow().to_pandas()

    def to_polars(self) -> Any:  # noqa: ANN401 - optional
        """Return a DataFrame of polars; ExtraMissingError if polars or pyarrow is not installed."""
        polars = load_extra("polars", "to_polars() needs polars")
        return polars.from_arrow(self.to_arrow())

    def __arrow_c_stream__(self, requested_schema: object = None) -> object:
        return self.to_arrow().__arrow_c_stream__(requested_schema)

    def __repr__(self) -> str:
        return f"<{len(self)} rows of {len(self.types)} columns: {', '.join(self.types)}>"


@dataclass(frozen=True, slots=True, kw_only=True)
class Analysis:
    """What the shifts of one drive say: everything that ``diag-service analyze`` shows.

    Attributes
    ----------
    paths : tuple of Path
        The logs, as they were named; none of a live bus.
    results : tuple of ShiftResult
        One for each shift, in their order, as they were found: the estimate of the shift alone, and the verdict on its
        clutch after it. SI units; times are bus times in nanoseconds since the epoch.
    summary : Mapping
        The numbers of the run as the last line of ``--json`` has them: ``summary["frames"]["decoded"]``.
    notices : tuple of str
        What the program warns of on standard error, as far as the level of the loggers ``diag_service`` and ``canlog``
        lets it through: faults of logs, slow messages, logs that contributed nothing.
    calibration : Calibration or None
        What new fluid is like, by which the results were made; without it there is no picture.
    """

    paths: tuple[Path, ...]
    results: tuple[ShiftResult, ...]
    summary: Mapping[str, Any]
    notices: tuple[str, ...] = ()
    calibration: Calibration | None = None

    @property
    def vehicle(self) -> str:
        """The id of the vehicle."""
        return str(self.summary["vehicle"])

    @property
    def is_complete(self) -> bool:
        """Whether the whole drive was seen; a part of one gets no verdict."""
        return bool(self.summary["complete"])

    @property
    def frames(self) -> Mapping[str, Any]:
        """What became of the frames: ``on_bus``, ``decoded``, ``ignored``, ``rejected`` by reason, ``missing``, ..."""
        frames: Mapping[str, Any] = self.summary["frames"]
        return frames

    @property
    def verdicts(self) -> dict[int, ClutchVerdict]:
        """The verdict on each clutch, 1 and 2, after its last shift; a clutch without a shift is not there."""
        return {int(record["clutch"]): verdict_from(record) for record in self.summary["clutches"]}

    @property
    def order(self) -> str:
        """What the vehicle is told to do about its fluid, with what each clutch says of it."""
        return str(self.summary["order"])

    @property
    def shifts(self) -> ResultTable:
        """A row for each shift, as all of them judge it; the table that ``analyze -o`` writes."""
        records = map(shift_record, self._judged)
        return ResultTable(columns(), list(drive_rows(self.paths, records, is_complete=self.is_complete)))

    @property
    def clutches(self) -> ResultTable:
        """A row for each clutch: its state after the drive."""
        return ResultTable(record_columns(Channel.CLUTCH), [flattened(record) for record in self.summary["clutches"]])

    def to_json(self) -> str:
        """Return what ``--json`` prints: a line of JSON for each shift, then one with the summary."""
        return "".join(f"{dump(record)}\n" for record in (*map(shift_record, self.results), dict(self.summary)))

    def plot(self, path: AnyPath | None = None) -> "Figure":
        """Draw the fan chart of the report: what is left of the friction margin, its limits, what is foretold.

        Parameters
        ----------
        path
            Where to write it as well: PNG, SVG or PDF, by the suffix.

        Returns
        -------
        matplotlib.figure.Figure
            A figure that no window or global state of matplotlib knows.

        Raises
        ------
        ExtraMissingError
            If matplotlib is not installed.
        OutputError
            If the file cannot be written.
        """
        figure = draw_fan(self._fan, legible(", ".join(log.name for log in self.paths) or self.vehicle))
        if path is not None:
            save_figure(figure, Path(path))
        return figure

    def __repr__(self) -> str:
        return f"<diag_service.Analysis of {self._name}: {self._outcome}>"

    def _repr_html_(self) -> str:
        """Return what a notebook shows."""
        from diag_service.report.page import notebook_of  # noqa: PLC0415 - a notebook alone needs it

        return notebook_of(self._name, self._outcome, self.order, self.notices, self._fan)

    @property
    def _judged(self) -> list[ShiftResult]:
        """The shifts as all of them judge them; of a part of a drive without a verdict."""
        gaps = tuple(Gap(gap) for gap in self.summary["incomplete"])
        return [unjudged(result, gaps) for result in with_revisions(self.results)]

    @property
    def _fan(self) -> Fan | None:
        """The fan chart, as a report of the same logs has it."""
        from diag_service.report.findings import findings_of_results  # noqa: PLC0415 - only pictures need a report
        from diag_service.report.page import fan_for  # noqa: PLC0415 - likewise

        if self.calibration is None or not self.results:
            return None
        return fan_for(findings_of_results(self.vehicle, self._judged, self.calibration))

    @property
    def _name(self) -> str:
        return legible(", ".join(map(str, self.paths)) or self.vehicle)

    @property
    def _outcome(self) -> str:
        words = [f"{len(self.results)} shifts"]
        words += [
            f"{name_of(verdict.clutch, verdict.element)} {condition_words(verdict.condition)}"
            for verdict in self.verdicts.values()
        ]
        return ", ".join(words if self.is_complete else [*words, "a part of the drive"])


def analyze(
    paths: AnyPaths,
    *,
    store: AnyPath | None = None,
    store_budget_mib: int | None = None,
    delivery: Delivery | None = None,
    is_strict: bool = False,
    **meaning: Unpack[LogMeaning],
) -> Analysis:
    """Diagnose the logs of one drive, as ``diag-service analyze LOG...`` does.

    Parameters
    ----------
    paths
        One log, or several of the same drive in any order; their contents say which format each has.
    vehicle
        Its id; without one the calibration's, or ``vehicle``.
    dbc
        Message database, DBC, KCD, ARXML or SYM, ``FILE#BUS`` for one bus of several; without one the shipped one.
    profile
        Which signals are which: a TOML file or the name of a shipped profile; without one the shipped one that fits.
    calibration
        Of the vehicle or its type: a TOML file, or the value that ``calibrate`` returns; without one the nominal one.
    store, store_budget_mib
        SQLite file that keeps results and running state, and how large it may grow [MiB]; without one the drive is
        judged for itself.
    delivery
        The broker that gets the results besides.
    is_strict
        Whether the first fault of a log is an error; else it is counted.
    columns
        Which column of a log that is a table is which, ``time=Time,id=ID,data=D1-D8``; by default its header says.

    Raises
    ------
    ConfigError, DefinitionError, CalibrationError
        If an argument, a database, a profile or a calibration cannot be used.
    SourceError
        If a log cannot be read or holds no frame; if ``is_strict``, also at its first fault.
    IncompleteError
        If ``is_strict`` and a log or a channel contributed nothing, or a log was cut. Otherwise a log that was cut
        gives an analysis whose ``is_complete`` is false.
    StoreError
        If the store cannot be opened or written.
    """
    logs = path_list(paths)
    if folder := next(filter(is_folder, logs), None):
        raise ConfigError(f"{folder} is a folder, in which every log is a drive: analyze_folders")
    options = AnalyzeOptions(
        logs=logs, store=optional_path(store), store_budget=store_budget_mib, strict=is_strict,
        **sent_to(delivery), **named(meaning),
    )  # fmt: skip
    return analyze_drive(options, Controls(), takes_part=True)


def analyze_drive(
    options: AnalyzeOptions,
    controls: Controls,
    *reporters: Reporter,
    watch: Watch | None = None,
    takes_part: bool = False,
) -> Analysis:
    """Diagnose the logs of one drive, tell ``reporters`` as it goes on, and write the file of results that is wanted.

    Raises what ``analyze`` raises; for a part of a drive IncompleteError or StoppedError unless one ``takes_part``.
    """
    if options.output is not None:
        check_replaceable(options.output, is_forced=options.force)
        check_output(options.output)  # now, not after hours
    memory = MemoryReporter()
    with collected_notices() as notices:
        config = as_proposed(diagnosis_config(options), options.paths, lambda: controls.stop.is_set)
        everyone = AllReporters(*reporters, memory)
        run = run_recorded(
            config, options.paths, options.store, everyone, controls.stop, survey=DriveSurvey, watch=watch
        )
    summary = run.summary
    if options.output is not None and Gap.STOPPED not in summary.gaps:
        write_results(options.output, [drive_entry("", options.paths, run, memory.results, notices)])
        _LOG.log(NOTICE, "%d shifts of 1 drives in %s", len(memory.results), options.output)
    if options.strict or not takes_part:
        check_complete(summary.gaps, summary.contributions, is_strict=options.strict)
    return Analysis(
        paths=tuple(options.paths),
        results=tuple(memory.results),
        summary=summary_record(summary),
        notices=tuple(notices),
        calibration=config.calibration,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperAnalysis:
    """What a drive says by the method of SAE 2015-01-1146, which states no uncertainty and gives no verdict."""

    shifts: tuple[PaperShift, ...]
    clutches: tuple[PooledClutch, ...]  # 1 and 2, all shifts together
    is_complete: bool  # whether the whole drive was seen
    notices: tuple[str, ...]


def analyze_by_paper(paths: AnyPaths, *, is_strict: bool = False, **meaning: Unpack[LogMeaning]) -> PaperAnalysis:
    """Analyse the logs of one drive as ``diag-service analyze --estimator paper`` does; arguments as of ``analyze``.

    Raises what ``analyze`` raises.
    """
    options = AnalyzeOptions(logs=path_list(paths), strict=is_strict, **named(meaning))
    analysis, account = analyze_drive_by_paper(options, Controls())
    if is_strict:
        account.check_complete(is_strict=True)
    return analysis


def analyze_drive_by_paper(
    options: AnalyzeOptions, controls: Controls, watch: Watch | None = None
) -> tuple[PaperAnalysis, Account]:
    """Analyse the logs of one drive, or a part of it, by the paper's method, and say what became of its frames."""
    stop, shifts = controls.stop, list[PaperShift]()
    with collected_notices() as notices:
        config = as_proposed(diagnosis_config(options), options.paths, lambda: stop.is_set)
        stages = Stages(config.interpretation().decoder(), config.calibration)
        collection = PaperCollection(config.calibration, nominal_driveline())
        with open_drive(
            options.paths,
            is_strict=options.strict,
            is_stopped=lambda: stop.is_set,
            watch=watch,
            columns=options.columns,
        ) as logs:
            account = replay(logs, stages, stop, lambda event: shifts.append(collection.add(event)))
    analysis = PaperAnalysis(
        shifts=tuple(shifts), clutches=collection.pooled(), is_complete=not account.gaps, notices=tuple(notices)
    )
    return analysis, account


SIZE_INCH: Final = (9.0, 4.5)
CLUTCH_COLOUR: Final = {1: "#b83a0a", 2: "#0b5cab"}
KIND_COLOUR: Final = {"watch": "#8f4a00", "change": "#a81c1c", "change_fluid": "#a81c1c"}  # of limits and moments
INK: Final = "#22303c"
MUTED: Final = "#526170"
ZONE_OPACITY: Final = 0.1
BAND_OPACITY: Final = 0.2


def draw_fan(fan: Fan | None, name: str) -> "Figure":
    """Return the figure, under the name of what was analysed; ExtraMissingError if matplotlib is not installed."""
    load_extra("matplotlib", "plot() needs matplotlib")
    from matplotlib.figure import Figure  # noqa: PLC0415 - an extra

    figure = Figure(figsize=SIZE_INCH, layout="constrained")
    axes = figure.subplots()
    axes.set_title(name, loc="right")
    axes.set_ylabel("friction margin [%], 100: new fluid")
    if fan is None:
        axes.set_title("no friction is known", loc="left")
        return figure
    first = fan.pasts[0]
    for past in reversed(fan.pasts):
        along, left, wide, _ = past.drawn
        colour = CLUTCH_COLOUR[past.clutch]
        axes.plot(along, left, color=colour, lw=2.2 if past is first else 1.2, label=past.title)
        axes.fill_between(
            along, left - wide, left + wide, color=colour, alpha=BAND_OPACITY, lw=0.0,
            label=PLUS_MINUS if past is first else None,
        )  # fmt: skip
    bottom, top = min(-12.0, axes.get_ylim()[0]), max(112.0, axes.get_ylim()[1])
    if len(fan.ahead):
        low, middle, high = fan.quantiles
        axes.fill_between(
            fan.ahead, low, high, color=INK, alpha=BAND_OPACITY, lw=0.0, label="forecast: 8 of 10 courses"
        )
        axes.plot(fan.ahead, middle, color=INK, lw=1.2, ls="--", label="its middle")
    for (limit, kind, text), base in zip(LIMITS, (0.0, bottom), strict=True):
        axes.axhspan(base, limit, color=KIND_COLOUR[kind], alpha=ZONE_OPACITY, lw=0.0)
        axes.axhline(limit, color=KIND_COLOUR[kind], lw=1.0, ls="--")
        axes.annotate(
            text, (0.0, limit), (4.0, 3.0), axes.get_yaxis_transform(), "offset points", color=KIND_COLOUR[kind]
        )
    for mark in fan.marks:
        colour, side = KIND_COLOUR.get(mark.kind, MUTED), 1.0 if mark.ends[0] == mark.place else -1.0
        axes.axvline(mark.place, color=colour, lw=1.0, ls="--")
        if mark.row is not None:
            at, align = (3.0 * side, -12.0 - 11.0 * mark.row), "left" if side > 0.0 else "right"
            axes.annotate(
                mark.text, (mark.place, 1.0), at, axes.get_xaxis_transform(), "offset points",
                color=colour, fontsize=8.0, ha=align,
            )  # fmt: skip
    axes.set_ylim(bottom, top)
    axes.set_xlabel(fan.label)
    figure.legend(loc="outside upper left", ncols=5, frameon=False, fontsize=8.0)
    return figure


def save_figure(figure: "Figure", path: Path) -> None:
    """Write a figure; raises OutputError if the file cannot be written, or its suffix is of no picture."""
    try:
        figure.savefig(path)
    except (OSError, ValueError) as exc:
        reason = exc.strerror if isinstance(exc, OSError) else None
        raise OutputError(f"cannot write {path}: {reason or exc}") from exc
