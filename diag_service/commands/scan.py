"""``diag-service scan``: which controllers answer on a bus, and what they can be asked."""

from types import SimpleNamespace

from diag_service.commands.asking import bus_name, doip_place, tell_wish, timing_of, waiting, write
from diag_service.console.reading import ReadingLine
from diag_service.errors import StoppedError
from diag_service.service.stopping import Controls
from diag_service.tester.addresses import hexadecimal
from diag_service.tester.asking import check_time, heard
from diag_service.tester.report import found_lines, found_record, outcome, traffic_record
from diag_service.tester.scanning import (
    ALL_NUMBERS,
    SHORTEST_WAIT_S,
    STANDARD_NUMBERS,
    ScanPlan,
    largest_id,
    request_ids,
    scan,
)


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Look for controllers and ask each what it can be asked; raises StoppedError if that was stopped."""
    plan = _plan(options)
    stop = controls.stop
    if not options.active:
        tell_wish(
            "scan", plan.requests, heard(plan.place, plan.listen_s, lambda: not stop.is_set), is_json=options.json
        )
    else:
        with ReadingLine() as line:
            found = scan(plan, goes_on=waiting(line, _what(plan), stop))
        traffic = {} if found.traffic is None else {"bus": traffic_record(found.traffic)}
        record = outcome("scan", is_asked=True, **traffic, controllers=[found_record(one) for one in found.controllers])
        write(record, found_lines(found.controllers), is_json=options.json)
    if stop.is_set:
        raise StoppedError("stopped early: what was shown is a part of what is there")


def _plan(options: SimpleNamespace) -> ScanPlan:
    timing = timing_of(options)
    check_time("--wait", options.wait, least_s=SHORTEST_WAIT_S)
    place = doip_place(options)
    most = largest_id(is_extended=options.extended)
    first, last = (
        None if text is None else hexadecimal(text, name, most)
        for text, name in ((options.first, "--first"), (options.last, "--last"))
    )
    return ScanPlan(
        place=place or bus_name(options),
        request_ids=() if place else request_ids(first, last, is_extended=options.extended),
        data=ALL_NUMBERS if options.all_data else STANDARD_NUMBERS,
        is_fd=options.fd,
        timing=timing,
        listen_s=options.listen,
        wait_s=options.wait,
    )


def _what(plan: ScanPlan) -> str:
    count = len(plan.request_ids)
    return f"asking {count} identifiers, which takes {count * plan.wait_s:.0f} s or more" if count else "asking"
