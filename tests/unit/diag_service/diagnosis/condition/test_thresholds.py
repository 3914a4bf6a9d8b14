"""The table of thresholds, its document, and how situations add to each other."""

import pytest

from diag_service.diagnosis.condition.thresholds import THRESHOLDS, Cause, Situation, given_at
from tests.support.documents import page_text
from tests.tools.threshold_table import PAGE, table, with_table

CHANGES = (Cause.SHUDDER, Cause.LEVEL_LOW, Cause.LOSS_LARGE)
LEVELS = (Cause.LEVEL_FALLING, Cause.LOSS_BEGUN)


def test_the_document_has_the_table_of_the_code() -> None:
    text = page_text(PAGE)
    assert with_table(text) == text
    assert table() in text


def test_a_document_without_a_place_for_it_is_refused() -> None:
    with pytest.raises(ValueError, match="no place for the table"):
        with_table("# The verdict\n")


def test_each_threshold_has_a_quantity_a_reason_and_a_source() -> None:
    for (ground, situation), threshold in THRESHOLDS.items():
        assert threshold.quantity, (ground, situation)
        assert threshold.reason, (ground, situation)
        assert threshold.source == "reasoned" or threshold.source.startswith("`"), (ground, situation)
    for cause in Cause:
        assert {(cause, situation) for situation in (Situation.MEANING, Situation.ALWAYS)} <= THRESHOLDS.keys()


@pytest.mark.parametrize(
    ("situations", "change", "level", "thin"),
    [
        ((), 0.95, 0.80, 0.70),
        ((Situation.EARLY,), 0.99, 0.80, 0.80),
        ((Situation.CALIBRATING,), 0.95, 0.98, 0.70),
        ((Situation.COLD,), 0.99, 0.98, 0.70),
        ((Situation.COLD, Situation.EARLY), 0.99, 0.98, 0.80),
        ((Situation.UNSURE_UP_TO_SCALE, Situation.EARLY), 0.99, 0.98, 0.98),
        ((Situation.LOCKUP,), 0.999, 0.999, 0.999),
    ],
)
def test_of_all_situations_that_hold_the_one_that_asks_most_decides(
    situations: tuple[Situation, ...], change: float, level: float, thin: float
) -> None:
    expected = dict.fromkeys(CHANGES, change) | dict.fromkeys(LEVELS, level) | {Cause.MARGIN_THIN: thin}
    assert given_at(*situations) == expected
