"""What of a result people read as words, the same wherever they read it."""

from diag_service.diagnosis.records import Condition, ShiftEstimate


def condition_words(condition: Condition) -> str:
    """Return the word of a verdict."""
    return condition.name.lower().replace("_", " ")


def kind_words(estimate: ShiftEstimate) -> str:
    """Return what kind of event it was."""
    return estimate.kind.value.replace("_", " ")


def gear_words(estimate: ShiftEstimate) -> str:
    """Return from which gear to which, or the gear of an event without a change."""
    is_change = estimate.from_gear != estimate.to_gear
    return f"{estimate.from_gear}-{estimate.to_gear}" if is_change else str(estimate.to_gear)


def reason_words(estimate: ShiftEstimate) -> str:
    """Return why an event was not used; empty if there is no reason."""
    return ", ".join(reason.value.replace("_", " ") for reason in estimate.reasons)
