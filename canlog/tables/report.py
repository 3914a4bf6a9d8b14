"""The account of a decoded log: for people what is missing or worth a look, for programs all of it as JSON."""

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from typing import Final

from canlog.decode.codec import FrameFate
from canlog.frames import EXTENDED_FLAG
from canlog.logs.fault_texts import assumed_texts, lost_texts, odd_texts
from canlog.tables.account import MAX_IDS, DecodeAccount
from canlog.tables.names import flagged_id, identifier_text

JsonObject = dict[str, object]

SCHEMA: Final = "clutchdiag/decode/v1"
SHOWN_COUNT: Final = 8  # of a list for people; a program gets all


def losses(account: DecodeAccount) -> Iterator[str]:
    """Yield for people what of the log is not in the table though it should be."""
    fates = account.fates
    yield from lost_texts(account.log)
    if account.frames_of_id and not account.known_count:
        yield _why_nothing(account)
    if count := account.of_group_count:
        yield (
            f"{count} frames have the parameter group (PGN) of a message of the database, but another identifier: "
            "--match group decodes them"
        )
    if cut_off := sum(counts.cut_off for counts in account.signals.values()):
        yield f"{fates[FrameFate.SHORT]} frames are shorter than their message: {cut_off} values are not in them"
    if transported := account.transported:
        sizes = {f"{name} ({size} bytes)": frames for name, (size, frames) in transported.items()}
        yield (
            f"{sum(sizes.values())} frames are pieces of messages longer than a frame, that could not be put together: "
            f"{listing(sizes)}"
        )
    if count := account.transfers.incomplete_count:
        yield f"{count} messages longer than a frame are incomplete: {'; '.join(account.transfers.in_words())}"
    if refused := list(account.refused.values()):
        more = f"; and {len(refused) - SHOWN_COUNT} more" if len(refused) > SHOWN_COUNT else ""
        yield f"{len(refused)} signals cannot be decoded: {'; '.join(refused[:SHOWN_COUNT])}{more}"
    for old, new in account.overwritten:
        yield f"message {old} has the identifier of {new}, by which its frames are decoded"


def _why_nothing(account: DecodeAccount) -> str:
    near = [
        f"{identifier_text(one.can_id)} of the log to {identifier_text(one.message_id)} {one.message}"
        + (f" ({one.remark})" if one.remark else "")
        for one in account.nearest()
    ]
    head = f"0 of {len(account.frames_of_id)} identifiers are in this database"
    return f"{head}; nearest: {'; '.join(near)}" if near else head


def remarks(account: DecodeAccount) -> Iterator[str]:
    """Yield for people what is in the table, or is missing by right, but may be worth a look."""
    yield from assumed_texts(account.log)
    yield from odd_texts(account.log)
    short_count, unknown = account.fates[FrameFate.SHORT], account.unknown_ids
    if short_count and not any(counts.cut_off for counts in account.signals.values()):
        yield f"{short_count} frames are shorter than their message, but hold all its signals"
    if unknown and account.known_count:
        frames = {identifier_text(can_id): count for can_id, count in unknown}
        yield f"{len(unknown)} of {len(account.frames_of_id)} identifiers are not in the database: {listing(frames)}"
    if account.unlisted_count:
        yield f"{account.unlisted_count} frames have identifiers beyond the first {MAX_IDS}, not listed one by one"
    for attribute, text in (("out_of_range", "outside [min|max]"), ("not_a_number", "that are not numbers")):
        counts = {account.names.columns[place]: getattr(one, attribute) for place, one in account.signals.items()}
        found = {name: count for name, count in counts.items() if count}
        if found:
            yield f"{sum(found.values())} values {text}, written as sent: " + listing(found)


def listing(counts: Mapping[str, int]) -> str:
    """Return the largest counts by name, and how many more there are."""
    largest = sorted(counts.items(), key=lambda one: (-one[1], one[0]))
    parts = [f"{name} {count}" for name, count in largest[:SHOWN_COUNT]]
    return ", ".join(parts + ([f"and {len(largest) - SHOWN_COUNT} more"] if len(largest) > SHOWN_COUNT else []))


def frame_texts(account: DecodeAccount) -> Iterator[str]:
    """Yield what became of the frames, in words; only what occurred."""
    words = {
        FrameFate.DECODED: "decoded",
        FrameFate.SHORT: "decoded in part",
        FrameFate.TRANSPORTED: "pieces of longer messages",
        FrameFate.WITHOUT_SIGNALS: "of messages without signals",
        FrameFate.UNKNOWN: "not in the database",
        FrameFate.REMOTE: "remote frames",
        FrameFate.ERROR: "error frames",
        FrameFate.LEFT_OUT: "not asked for",
    }
    for fate, count in account.fates.items():
        if count or fate is FrameFate.DECODED:
            yield f"{count} {words[fate]}"


def values_text(account: DecodeAccount) -> str:
    """Return how many values there are, in words."""
    values = sum(counts.values for counts in account.signals.values())
    return f"{values} values of {len(account.signals)} signals in {len(account.valued_slots)} messages"


def account_record(account: DecodeAccount) -> JsonObject:
    """Return the account; ``frames`` without ``read`` add up to ``read``."""
    log = account.log
    return {
        "schema": SCHEMA,
        "rows": account.row_count,
        "frames": {"read": log.frames, **{fate.name.lower(): count for fate, count in account.fates.items()}},
        "unreadable": {reason.value: count for reason, count in log.rejected.items()},
        "first_unreadable": log.first_rejected,
        "truncated": log.truncated,
        "unfinished": log.unfinished,
        "jumps_back": log.jumps_back,
        "jumps_ahead": log.jumps_ahead,
        "first_jump": log.first_jump,
        "repeated": log.repeated,
        "notes": list(log.notes),
        "identifiers": {
            "seen": len(account.frames_of_id),
            "known": account.known_count,
            "unlisted_frames": account.unlisted_count,
            "unknown": [{**_identifier(can_id), "frames": count} for can_id, count in account.unknown_ids],
            "nearest": [
                {**_identifier(one.can_id), "message": one.message, "message_id": identifier_text(one.message_id)}
                for one in (() if account.known_count else account.nearest())
            ],
        },
        "long_messages": {
            "whole": {protocol.value: count for protocol, count in account.transfers.whole.items()},
            "incomplete": {
                f"{protocol.value}.{fault.value}": count
                for (protocol, fault), count in account.transfers.incomplete.items()
            },
        },
        "messages": [_message(account, slot) for slot in account.seen_slots],
        "refused": account.refused,
        "overwritten": [{"message": old, "by": new} for old, new in account.overwritten],
        "losses": list(losses(account)),
    }


def _message(account: DecodeAccount, slot: int) -> JsonObject:
    """Return one message that came, with all of its signals that were looked for."""
    message = account.codec.tables[slot].message
    fates = account.of_message(slot)
    return {
        "message": account.names.messages[slot],
        "id": identifier_text(flagged_id(message)),
        "is_extended": message.is_extended_frame,
        "bytes": message.length,
        "frames": {fate.name.lower(): fates[fate] for fate in FrameFate if fate in fates},
        "put_together": account.long_counts.get(slot, 0),
        "signals": {
            name: {"column": account.names.columns[slot, name], **asdict(account.signals[slot, name])}
            for name in account.codec.tables[slot].signals
            if (slot, name) in account.signals
        },
    }


def _identifier(can_id: int) -> JsonObject:
    return {"id": identifier_text(can_id), "is_extended": bool(can_id & EXTENDED_FLAG)}
