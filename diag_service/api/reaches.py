"""Which vehicles can be judged at all: what each log of some folders can tell, and what would be needed for more."""

from collections.abc import Generator, Sequence
from concurrent.futures.process import BrokenProcessPool
from functools import partial
from pathlib import Path

from canlog.errors import SourceError
from canlog.files import is_folder
from canlog.logs import STANDARD_INPUT
from diag_service.api.choices import AnyPaths, path_list
from diag_service.batch.drives import split_folder, vehicle_by_folder
from diag_service.batch.log_reach import LogReach, LogTask, look_into, unreadable
from diag_service.batch.worker import DEADLY, job_count, progress_bar, run_in_processes
from diag_service.errors import ConfigError, StoppedError
from diag_service.mapping.interpretation import open_database
from diag_service.settings.options import SignalsOptions
from diag_service.stopping import Controls


def survey_logs(
    paths: AnyPaths,
    dbc: AnyPaths = (),
    *,
    columns: str = "",
    jobs: int | None = None,
    has_vehicles: bool = False,
) -> tuple[LogReach, ...]:
    """Return what each log of some folders can tell, as ``diag-service signals FOLDER`` shows it.

    Each log is read with every shipped profile, on its own database and on those that are given; the one that gets
    most out of it is named. What counts is what came, not what a profile names. Processes are started for it: a script
    that calls it must guard its top level by ``if __name__ == "__main__":``.

    Parameters
    ----------
    paths
        Folders, with what is below them, and single logs.
    dbc
        Databases of buses that may be among the logs; none, one or several.
    columns
        As of ``analyze``.
    jobs
        Logs at a time; by default one per core.
    has_vehicles
        Whether the folders below those that are named are called after vehicles, whose logs they hold.

    Returns
    -------
    tuple of LogReach
        A row for each file, by vehicle and path; one that is no log or cannot be read says why in ``remarks``.

    Raises
    ------
    ConfigError, DefinitionError
        If an argument or a database cannot be used.
    SourceError
        If a path is not there.
    """
    options = SignalsOptions(
        logs=path_list(paths), dbc=tuple(path_list(dbc)) if dbc else (), columns=columns, jobs=jobs,
        vehicle_from="path" if has_vehicles else None,
    )  # fmt: skip
    return tuple(sorted(survey(options, Controls()), key=place_of))


def place_of(row: LogReach) -> tuple[str, str]:
    """Return where a row stands: by vehicle, then by path."""
    return row.vehicle or "", str(row.path)


def survey(options: SignalsOptions, controls: Controls, *, is_shown: bool = False) -> Generator[LogReach, None, None]:
    """Yield a row for each file as soon as it was looked into; a bar goes to standard error if ``is_shown``.

    Raises what ``survey_logs`` does, and StoppedError if it was stopped before every log was looked into.
    """
    jobs = job_count(options.jobs)
    for dbc in options.dbc:
        open_database(dbc)  # now, not in each process
    tasks, others = _tasks(options)
    yield from others
    if not tasks:
        return
    done_count, work = 0, partial(look_into)
    with progress_bar(is_shown=is_shown) as progress:
        sizes = {task: task.path.stat().st_size for task in tasks}
        bar = progress.add_task("looking into logs", total=sum(sizes.values()), done=0, of=len(tasks))
        for task, future in run_in_processes(work, tasks, jobs, controls.stop, is_shown=False):
            try:
                row = future.result()
            except BrokenProcessPool:
                row = unreadable(task, DEADLY)
            done_count += 1
            progress.update(bar, advance=sizes[task], done=done_count)
            yield row
    if done_count < len(tasks):
        raise StoppedError(f"stopped early: {done_count} of {len(tasks)} logs were looked into")


def _tasks(options: SignalsOptions) -> tuple[list[LogTask], list[LogReach]]:
    """Return the logs to look into, and rows of what is no log; raises ConfigError, SourceError."""
    if STANDARD_INPUT in options.logs:
        raise ConfigError("several logs are read by several processes: standard input does not go with them")
    tasks, rows, known = list[LogTask](), list[LogReach](), set[Path]()
    for path in options.logs:
        logs, others = [path], []
        if is_folder(path):
            found, left_out = split_folder(path, options.columns)
            logs, others = [log.path for log in found], left_out
        elif not path.exists():
            raise SourceError(f"{path}: No such file or directory")
        for log in logs:
            if log.resolve() in known:
                continue
            known.add(log.resolve())
            tasks.append(
                LogTask(path=log, dbcs=options.dbc, columns=options.columns, vehicle=_vehicle(options, log, path))
            )
        rows += [
            unreadable(LogTask(path=left.path, vehicle=_vehicle(options, left.path, path)), left.reason)
            for left in others
        ]
    return tasks, rows


def _vehicle(options: SignalsOptions, log: Path, named: Path) -> str | None:
    """Return the vehicle that the folders of a file speak of, if they are to be asked; raises ConfigError."""
    return vehicle_by_folder(log, named) if options.vehicle_from is not None and log != named else None


def best_of_vehicles(rows: Sequence[LogReach]) -> dict[str, LogReach]:
    """Return the row of each vehicle that gets most out of it, by the name of the vehicle."""
    best = dict[str, LogReach]()
    for row in rows:
        if row.vehicle is not None and (row.vehicle not in best or row.rank < best[row.vehicle].rank):
            best[row.vehicle] = row
    return best
