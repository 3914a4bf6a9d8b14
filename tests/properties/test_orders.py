"""One order for a vehicle: whatever verdicts, prognoses and fills there are, no text contradicts another."""

import re
from dataclasses import replace
from datetime import datetime, timedelta

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from clutch_results.prognosis import Passage, Prognosis
from clutch_results.prognosis.channels import DISTANCE_M
from clutch_results.prognosis.prognosis import Outlook, Reach
from clutch_results.prognosis.sentence import distance_left, outlook_line
from clutch_results.records import (
    Causes,
    Condition,
    FluidFill,
    LikelyCause,
    ShiftResult,
    clutch_record,
    iso_utc,
    shift_record,
    utc_from_bus_ns,
)
from diag_service.delivery.console import order_lines
from diag_service.diagnosis.condition.condition import no_verdict
from diag_service.diagnosis.condition.verdict import Cause, Silence, advice
from diag_service.diagnosis.summary import of_present_fluid, order_by
from fleet_backend.queries import with_orders
from fleet_contract.orders import UNKNOWABLE, Action, Order
from tests.support.builders import shift_result
from tests.support.fleet import row_of

NEVER = Passage(distance_m=DISTANCE_M, probability=np.zeros_like(DISTANCE_M))
EARLIER = {  # what programs before wrote as advice
    Condition.CHANGE_FLUID: (
        "Clutch {}: change the fluid now: its fluid lets it shudder (98 % sure).",
        (
            "Clutch {}: change the fluid now: its friction is below 80 % of new (24 % sure, after at least 95 %; "
            "called off below 20 %)."
        ),
    ),
    Condition.WATCH: (
        (
            "Clutch {}: have the fluid changed at the next service: 50 % of its margin against shudder are gone "
            "(85 % sure)."
        ),
    ),
    Condition.GOOD: (
        "Clutch {}: nothing to do until the next service: its fluid is sound (over 99 % sure).",
        "Clutch {}: nothing to do now, but measure again after more drives: its fluid is sound (60 % sure).",
    ),
    Condition.NO_VERDICT: (
        "Clutch {}: drive on and measure again: fewer than 3 of its shifts could be used.",
        "Clutch {}: have its launches looked at: the clutch slips again after it has stuck, its friction says not why.",
        (
            "Clutch {}: no verdict: the calibration does not fit this vehicle; let diag-service calibrate make its "
            "own, then measure again."
        ),
        "Clutch {}: no verdict: the signals of this vehicle do not tell its friction.",
    ),
}
CAUSES = {
    Condition.CHANGE_FLUID: (Cause.SHUDDER, Cause.LEVEL_LOW, Cause.LOSS_LARGE),
    Condition.WATCH: (Cause.MARGIN_THIN, Cause.LEVEL_FALLING, Cause.LOSS_BEGUN),
}
ORDERS = {
    Action.CHANGE_NOW: r"Change the fluid now\.",
    Action.CHANGE_AT_SERVICE: r"Have the fluid changed at the next service\.",
    Action.FIND_CAUSE: (
        r"(See to (another cause than the fluid|this) first|Have something else than the fluid looked at): "
        r".* % likely\)\."
    ),
    Action.NEW_FLUID: r"New fluid since .*: nothing is known of it yet\.",
    Action.MEASURE_AGAIN: (
        r"There is no verdict on the fluid( yet|: friction cannot be known from this car|: the torque .* at best)\."
    ),
    Action.NOTHING: r"Nothing to do now(: the fluid is sound|, but measure again after more drives: .* seems sound)\.",
}


def sentences(clutch: int, condition: Condition) -> st.SearchStrategy[str | None]:
    if condition in CAUSES:
        cause, sure = st.sampled_from(CAUSES[condition]), st.floats(0.2, 1.0)
        own = st.builds(lambda one, chance: advice(clutch, one, chance), cause, sure)
    elif condition is Condition.GOOD:
        own = st.floats(0.2, 1.0).map(lambda chance: advice(clutch, None, chance))
    else:
        own = st.sampled_from(Silence).map(lambda one: advice(clutch, one))
    return own | st.sampled_from([text.format(clutch) for text in EARLIER[condition]]) | st.none()


WORDS = ("sound", "aged-fluid", "wrong-fluid", "water", "glazed-lining", "weak-pump", "something-else")


@st.composite
def causes(draw: st.DrawFn) -> Causes | None:
    """Draw why a vehicle is as it is."""
    if draw(st.booleans()):
        return None
    shares = sorted(draw(st.lists(st.floats(0.01, 1.0), min_size=1, max_size=3)), reverse=True)
    words = draw(st.permutations(WORDS))
    likely = (
        LikelyCause(cause=word, clutch=2 if word == "glazed-lining" else None, probability=share, evidence="For it: .")
        for word, share in zip(words, shares, strict=False)
    )
    return Causes(event_count=30, likely=tuple(likely), advice="Measure.", test=None)


@st.composite
def results(draw: st.DrawFn) -> list[ShiftResult]:
    """Draw the last results of none, one or both clutches."""
    found, why = [], draw(causes())
    for clutch in draw(st.lists(st.sampled_from([1, 2]), unique=True)):
        one, condition = shift_result(10 + clutch, to_gear=4 - clutch), draw(st.sampled_from(Condition))
        text, later_ns = draw(sentences(clutch, condition)), draw(st.integers(0, 10)) * 60_000_000_000
        estimate = replace(
            one.estimate, start_ns=one.estimate.start_ns + later_ns, end_ns=one.estimate.end_ns + later_ns
        )
        verdict = replace(one.verdict, clutch=clutch, condition=condition, advice=text, causes=why)
        found.append(replace(one, estimate=replace(estimate, clutch=clutch), verdict=verdict))
    return found


def moment(minutes: int) -> datetime:
    return datetime.fromisoformat(utc_from_bus_ns(shift_result(11).estimate.end_ns)) + timedelta(minutes=minutes)


fluids = st.none() | st.integers(-5, 15).map(
    lambda minutes: FluidFill(vehicle="car1", filled_at=iso_utc(moment(minutes)), product="DCTF-II")
)
distances = st.none() | st.sampled_from([0.0, 1.0e6, 1.4e7]) | st.floats(0.0, 3.0e8)


@st.composite
def prognoses(draw: st.DrawFn) -> list[Prognosis]:
    found = []
    for clutch in (1, 2):
        outlook, reach = draw(st.sampled_from(Outlook)), None
        if outlook is not Outlook.TOO_FEW:
            ends = sorted((draw(distances) for _ in range(3)), key=lambda one: (one is None, one or 0.0))
            reach = Reach(
                p10_m=ends[0], p50_m=ends[1], p90_m=ends[2],
                probability_before_service=draw(st.floats(0.0, 1.0)), passage=NEVER,
            )  # fmt: skip
        found.append(
            Prognosis(
                clutch=clutch,
                outlook=outlook,
                row_count=draw(st.integers(0, 9)),
                service_distance_m=1.5e7,
                fluid_starts=(),
                assumptions=(),
                watch=reach,
                change_fluid=reach,
                left_out_count=draw(st.integers(0, 3)),
            )
        )
    return found


def check(order: Order, outlook: str) -> None:
    """Fail if a text contradicts another."""
    given_orders = [action for action, words in ORDERS.items() if re.search(words, order.text)]
    assert given_orders == [order.action]
    assert re.fullmatch(ORDERS[order.action], order.sentence)
    assert not re.search("drive on|due|already|nothing to do|change the|changed at", " ".join(order.reasons))
    assert not re.search("already|may be due|drive on|(?<!before the )next service|None|nan", outlook)
    clutches = (
        [] if order.sentence in UNKNOWABLE.values() else ["Clutch 1:", "Clutch 2:"]
    )  # that is said of the vehicle
    assert [reason[:9] for reason in order.reasons] == clutches
    if order.action is Action.FIND_CAUSE:
        assert outlook.startswith("No prognosis of the fluid before that was seen to.")
    if order.action is Action.CHANGE_NOW:
        assert outlook.startswith("No prognosis: the fluid is to be changed now.")
    else:
        assert not re.search(r"\bnow\b", outlook)
    if order.action is Action.NEW_FLUID:
        assert "% sure" not in order.text + outlook
    if order.action is Action.NOTHING:
        assert all("friction is sound" in one or one.count("good: ") for one in order.reasons)


ORDERED = {Condition.WATCH, Condition.CHANGE_FLUID}


@given(known=results(), fluid=fluids, founds=prognoses())
def test_no_text_contradicts_another(
    known: list[ShiftResult], fluid: FluidFill | None, founds: list[Prognosis]
) -> None:
    order = order_by(known, fluid)
    outlook, left = outlook_line(founds, order.action), distance_left(founds, order.action)
    check(order, outlook)
    is_silent = re.search("No prognosis|cannot be said", outlook) is not None
    assert is_silent is (left in {"0 km left", "km left: not known yet"})
    assert (left == "0 km left") is (order.action is Action.CHANGE_NOW)
    assert is_silent or all(number in outlook for number in re.findall(r"\d[\d,]*", left))
    assert order_by(known[::-1], fluid) == order
    since = None if fluid is None else datetime.fromisoformat(fluid.filled_at)
    speaking = [one for one in known if fluid is None or utc_from_bus_ns(one.estimate.end_ns) > fluid.filled_at]
    if since is not None and not speaking:
        assert order.action is Action.NEW_FLUID
    worst = max((one.verdict.condition for one in speaking), default=Condition.NO_VERDICT)
    if order.action is Action.FIND_CAUSE:
        (why,) = {one.verdict.causes for one in speaking}
        assert why is not None
        others = (one for one in why.likely if one.cause not in {"sound", "aged-fluid"})
        likeliest = max(others, key=lambda one: one.probability)
        assert (likeliest.cause in {"water", "wrong-fluid"}) is order.sentence.startswith("See to this first")
        assert likeliest.probability >= (0.5 if worst in ORDERED else 0.9)
    else:
        assert (order.action is Action.CHANGE_NOW) is (worst is Condition.CHANGE_FLUID)
        assert (order.action is Action.CHANGE_AT_SERVICE) is (worst is Condition.WATCH)
    for one in speaking:
        if one.verdict.advice is None and one.verdict.condition is not Condition.NO_VERDICT:
            assert one.verdict.reason in order.reasons[one.verdict.clutch - 1]


def test_where_friction_cannot_be_known_it_is_said_once_and_no_clutch_waits_for_an_event() -> None:
    result = shift_result(11)
    verdict = no_verdict(1, "friction needs clutch 1 pressure", Silence.SIGNALS_MISSING)
    untold = replace(result, verdict=verdict, estimate=replace(result.estimate, clutch=1))
    order = order_by([untold], None)
    assert order.text == "There is no verdict on the fluid: friction cannot be known from this car."
    assert order.action is Action.MEASURE_AGAIN
    row = {**row_of(untold), "happened_at": moment(0), "stored_at": moment(0), "fluid": None, "fluid_since": None}
    assert next(with_orders([row], {}, {}))["order"] == order.text


@given(known=results(), fluid=fluids)
def test_all_who_tell_tell_the_same(known: list[ShiftResult], fluid: FluidFill | None) -> None:
    order = order_by(known, fluid)
    assert " ".join(line.plain for line in order_lines(order)) == order.text
    rows = [
        {
            **row,
            "happened_at": row["end_at"],
            "stored_at": row["end_at"],
            "shift_count": one.verdict.shift_count,
            "fluid": None,
            "fluid_since": None,
        }
        for one in known
        for row in [row_of(one)]
    ]
    filled = {} if fluid is None else {"car1": (moment_of(fluid), "DCTF-II")}
    states = of_present_fluid(known, fluid)
    for row, state in zip(with_orders(rows, filled, {}), states, strict=True):
        told = clutch_record(shift_record(state), order)
        assert (row["action"], row["order"]) == (told["action"], told["order"])
        assert (row["condition"], row["advice"]) == (told["condition"], told["advice"])
        assert row["shift_count"] == told["shift_count"]


def moment_of(fluid: FluidFill) -> datetime:
    return datetime.fromisoformat(fluid.filled_at)
