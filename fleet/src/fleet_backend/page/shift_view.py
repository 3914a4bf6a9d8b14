"""One event of a vehicle: friction over slip, what its data were worth, and why it was or was not used."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Any, Final

from clutch_model.units import degc_from_k, reading_of
from clutch_results.pictures import curve_figure
from clutchdiag_io.pages.content import NONE, Advice, Cell, Figure, Link, Number, Section, Table, moment, number
from clutchdiag_io.people import PER_1000_RPM, PLUS_MINUS, SLOPE_UNIT, STDS, digits, moment_words
from fleet_backend.errors import NotFoundError
from fleet_backend.page import past, wording
from fleet_backend.page.asking import VEHICLE, Ask, Parameter, ParameterType
from fleet_backend.page.calibrations import reference_of
from fleet_backend.page.outlook import friction_of
from fleet_backend.page.records import ShiftAnswer
from fleet_backend.page.view import Shown, Sources, View
from fleet_contract.orders import name_of

_PARAMETERS: Final = (
    VEHICLE,
    Parameter(
        name="stream", text="stream of results: a run of a service, or a log", is_required=True, pattern="[ -~]{1,128}"
    ),
    Parameter(name="seq", text="position in the stream", kind=ParameterType.COUNT, is_required=True),
)
_SIGNALS: Final = "The fleet keeps no signals of single events; diag-service report shows those of a log."
_QUANTITIES: Final = (
    ("mu_C, at high slip", "mu_c", "std_mu_c", 1.0),
    ("mu_S, at no slip", "mu_s", "std_mu_s", 1.0),
    (f"slope {SLOPE_UNIT}", "slope_s_rad", "std_slope_s_rad", PER_1000_RPM),
)


def find(sources: Sources, ask: Ask) -> ShiftAnswer:
    """Return an event; raises NotFoundError if there is none."""
    found = past.shift_of(sources.engine, ask.said("vehicle"), ask.said("stream"), ask.count("seq"))
    if found is None:
        raise NotFoundError(f"{ask.said('vehicle')} has no event {ask.count('seq')} in this stream")
    return found


def show(answer: ShiftAnswer, _ask: Ask, _sources: Sources) -> Shown:
    """Return the page of an event."""
    kind = (answer.kind or "shift").replace("_", " ")
    gears = f"{answer.from_gear}-{answer.to_gear}" if answer.from_gear != answer.to_gear else str(answer.to_gear)
    vehicle, clutch = wording.vehicle_link(answer.vehicle), name_of(answer.clutch, answer.element)
    verdict = Advice(
        condition=wording.style(answer.condition),
        word=wording.condition_word(answer.condition),
        text=answer.advice or answer.condition_reason,
    )
    return Shown(
        title=f"{kind.capitalize()} {gears} of {answer.vehicle}",
        subtitle=f"{clutch}, {moment_words(answer.end_at, '%Y-%m-%d %H:%M:%S UTC')}, data {answer.status}",
        sections=(
            _friction_section(answer),
            *_shift_sections(answer),
            _quality_section(answer),
            _facts_section(answer),
        ),
        advice=(verdict,),
        trail=(Link(text="Fleet", href="/"), vehicle),
    )


def _friction_section(answer: ShiftAnswer) -> Section:
    reference = reference_of(answer.vehicle, answer.calibration_version, answer.clutch)
    figures: list[Figure] = []
    texts: list[str] = []
    for values, what in ((answer.friction, "this event alone"), (answer.running, "all events so far")):
        friction = friction_of(values)
        if friction is not None and reference is not None:
            figures.append(curve_figure(answer.clutch, friction, reference, what))
    if answer.friction is None:
        texts.append(f"This event does not tell the friction: {wording.words(answer.reasons)}.")
    texts.append(_SIGNALS)
    if reference is None:
        texts.append("Curves are not drawn: its service has not told what calibration this result is of.")
    return Section(
        name="friction",
        title="Friction over slip",
        texts=tuple(texts),
        figures=tuple(figures),
        tables=(Table(caption="Friction", head=_FRICTION_HEAD, rows=tuple(_friction_rows(answer))),),
    )


_FRICTION_HEAD: Final = ("quantity", "this event", PLUS_MINUS, "all so far", PLUS_MINUS)


def _friction_rows(answer: ShiftAnswer) -> Iterator[tuple[Cell, ...]]:
    own, running = answer.friction or {}, answer.running or {}
    for name, value, std, scale in _QUANTITIES:
        told = [(some.get(value), some.get(std)) for some in (own, running)]
        yield name, *(number(one, scale=scale) for at, off in told for one in (at, off and STDS * off))
    chances = [wording.probability(some.get("probability_negative_slope")) for some in (own, running)]
    yield "probability of a falling slope", chances[0], NONE, chances[1], NONE


def _shift_sections(answer: ShiftAnswer) -> Iterator[Section]:
    """Yield how well the event went, if that is known."""
    if answer.shift_quality is not None:
        rows = tuple(_quality_rows(asdict(answer.shift_quality)))
        table = Table(caption="Score and its parts", head=("part", "value", PLUS_MINUS, "unit"), rows=rows)
        yield Section(name="shifting", title="How well it went", tables=(table,))


def _quality_rows(told: Mapping[str, Any]) -> Iterator[tuple[Cell, ...]]:
    for name, value in told.items():
        if (reading := reading_of(told, name)) is not None:
            label, shown, std, unit = reading
            off = NONE if std is None else Number(value=STDS * told[f"std_{name}"], text=digits(STDS * std))
            yield label.replace("_", " "), Number(value=value, text=digits(shown)), off, unit


def _quality_section(answer: ShiftAnswer) -> Section:
    parts = [("all together", wording.quality(answer.trust))]
    parts += [(name, wording.quality(value)) for name, value in (answer.trust_parts or {}).items()]
    texts = [f"Why it was not used: {wording.words(answer.reasons)}."] if answer.reasons else []
    if answer.trust is None:
        texts.append("The quality of the data is not known: an older program made this result.")
    believed = Table(caption="Quality of the data, from 0 to 1", head=("part", "quality"), rows=tuple(parts))
    window = Table(
        caption="The estimate",
        head=("what", "value"),
        rows=(
            ("quality of the slip window, from 0 to 1", wording.quality(answer.quality)),
            ("samples in it", str(answer.sample_count)),
            ("its length [s]", number(answer.window_s, "{:.3f}")),
            ("chi-square per degree of freedom", number(answer.chi_square_ratio, "{:.2f}")),
        ),
    )
    tables = (window,) if answer.trust is None else (believed, window)
    return Section(name="quality", title="Data quality", texts=tuple(texts), tables=tables)


def _facts_section(answer: ShiftAnswer) -> Section:
    rows: tuple[tuple[Cell, ...], ...] = (
        ("start (UTC)", moment(answer.start_at)),
        ("end (UTC)", moment(answer.end_at)),
        ("duration [s]", number(answer.duration_s, "{:.2f}")),
        ("how it ended", wording.plain(answer.end_reason and answer.end_reason.replace("_", " "))),
        ("odometer [km]", wording.km(answer.odometer_m)),
        ("oil in the sump [°C]", _degc(answer.sump_temperature_k)),
        ("clutch [°C]", _degc(answer.clutch_temperature_k)),
        ("slip energy [kJ]", number(answer.slip_energy_j, "{:.2f}", scale=1e-3)),
        ("shifts in the running estimate", str(answer.running_shift_count)),
        ("friction against new", wording.share(answer.level_ratio)),
        ("algorithm", answer.algorithm_version),
        ("calibration", answer.calibration_version),
        ("older versions of this result", "; ".join(answer.older_versions) or NONE),
        ("stream", answer.stream),
        ("position in it", str(answer.seq)),
        ("stored at (UTC)", moment(answer.stored_at)),
    )
    return Section(name="facts", title="The event", tables=(Table(caption="Facts", head=("what", "value"), rows=rows),))


def _degc(temperature_k: float | None) -> Cell:
    return number(None if temperature_k is None else degc_from_k(temperature_k), "{:.1f}")


VIEW: Final = View(
    name="shift",
    page_path="/vehicles/{vehicle}/shift",
    text="One event of a vehicle: its own estimate, the running one after it, and what its data were worth.",
    parameters=_PARAMETERS,
    answer=ShiftAnswer,
    find=find,
    show=show,
)
