"""The account of a decoded log for people: what is not in the table, and what may be worth a look."""

from collections.abc import Iterator, Mapping
from typing import Final

import numpy as np

from canlog.decode.codec import HAS_VALUES, FrameFate
from canlog.frames import EXTENDED_FLAG
from canlog.tables.account import MAX_IDS, Account
from canlog.tables.names import identifier_text

SHOWN_COUNT: Final = 8  # of a list for people; a program gets all
_BARE_ID: Final = 0x1FFF_FFFF


def losses(account: Account) -> Iterator[str]:
    """Yield for people what of the log is not in the table though it should be."""
    log, fates = account.log, account.fates
    if log.truncated:
        yield "the log ends before its own end"
    if log.first_rejected:
        rejected = {reason.value: count for reason, count in log.rejected.items()}
        head = _with_reasons(f"{sum(rejected.values())} pieces of the log are no frames", rejected)
        yield f"{head}, the first: {log.first_rejected}"
    if account.frames_of_id and not account.known_count:
        yield _why_nothing(account)
    if cut_off := sum(counts.cut_off for counts in account.signals.values()):
        yield f"{fates[FrameFate.SHORT]} frames are shorter than their message: {cut_off} values are not in them"
    if fates[FrameFate.TRANSPORTED]:
        sizes = {f"{name} ({size} bytes)": frames for name, (size, frames) in account.transported.items()}
        yield (
            f"{fates[FrameFate.TRANSPORTED]} frames are pieces of messages longer than a frame, which need ISO-TP "
            f"or J1939 transport and are not decoded: {listing(sizes)}"
        )
    if refused := list(account.refused.values()):
        more = f"; and {len(refused) - SHOWN_COUNT} more" if len(refused) > SHOWN_COUNT else ""
        yield f"{len(refused)} signals cannot be decoded: {'; '.join(refused[:SHOWN_COUNT])}{more}"
    if account.packet_count and (long := account.long_messages):
        names = ", ".join([*long[:SHOWN_COUNT], *(["..."] if len(long) > SHOWN_COUNT else [])])
        yield (
            f"{account.packet_count} frames are packets of J1939 transport, which are not put together; of the "
            f"database these messages come that way: {names}"
        )
    for old, new in account.overwritten:
        yield f"message {old} has the identifier of {new}, by which its frames are decoded"


def _why_nothing(account: Account) -> str:
    near = [
        f"{shown(one.can_id)} of the log to {shown(one.message_id)} {one.message}"
        + (f" ({one.remark})" if one.remark else "")
        for one in account.nearest()
    ]
    head = f"0 of {len(account.frames_of_id)} identifiers are in this database"
    return f"{head}; nearest: {'; '.join(near)}" if near else head


def remarks(account: Account) -> Iterator[str]:
    """Yield for people what is in the table, or is missing by right, but may be worth a look."""
    log = account.log
    yield from log.notes
    if log.unfinished:
        yield "the log was never closed by its writer: what is missing at its end cannot be told"
    if jumps := log.jumps_back + log.jumps_ahead:
        yield f"{jumps} jumps of time, {log.jumps_back} of them back, the first: {log.first_jump}"
    if log.repeated:
        yield f"{log.repeated} frames equal the one before, time and all"
    short_count, unknown = account.fates[FrameFate.SHORT], account.unknown_ids
    if short_count and not any(counts.cut_off for counts in account.signals.values()):
        yield f"{short_count} frames are shorter than their message, but hold all its signals"
    if unknown and account.known_count:
        frames = {shown(can_id): count for can_id, count in unknown}
        yield f"{len(unknown)} of {len(account.frames_of_id)} identifiers are not in the database: {listing(frames)}"
    if account.unlisted_count:
        yield f"{account.unlisted_count} frames have identifiers beyond the first {MAX_IDS}, not told one by one"
    for attribute, text in (("out_of_range", "outside [min|max]"), ("not_a_number", "that are no numbers")):
        counts = {account.names.columns[place]: getattr(one, attribute) for place, one in account.signals.items()}
        found = {name: count for name, count in counts.items() if count}
        if found:
            yield f"{sum(found.values())} values {text}, written as sent: " + listing(found)


def listing(counts: Mapping[str, int], shown_count: int = SHOWN_COUNT) -> str:
    """Return the largest counts by name, and how many more there are."""
    largest = sorted(counts.items(), key=lambda one: (-one[1], one[0]))
    parts = [f"{name} {count}" for name, count in largest[:shown_count]]
    return ", ".join(parts + ([f"and {len(largest) - shown_count} more"] if len(largest) > shown_count else []))


def shown(can_id: int) -> str:
    """Return an identifier with its flags for people."""
    return identifier_text(can_id & _BARE_ID, is_extended=bool(can_id & EXTENDED_FLAG))


def frame_texts(account: Account) -> Iterator[str]:
    """Yield what became of the frames, in words; only what occurred."""
    words = {
        FrameFate.DECODED: "decoded",
        FrameFate.SHORT: "decoded in part",
        FrameFate.TRANSPORTED: "pieces of longer messages",
        FrameFate.WITHOUT_SIGNALS: "of messages without signals",
        FrameFate.UNKNOWN: "of no message of the database",
        FrameFate.REMOTE: "remote frames",
        FrameFate.ERROR: "error frames",
    }
    for fate, count in account.fates.items():
        if count or fate is FrameFate.DECODED:
            yield f"{count} {words[fate]}"


def values_text(account: Account) -> str:
    """Return how many values there are, in words."""
    values = sum(counts.values for counts in account.signals.values())
    with_values = int(np.count_nonzero(account.counts[:-1, list(HAS_VALUES)].sum(axis=1)))
    return f"{values} values of {len(account.signals)} signals in {with_values} messages"


def _with_reasons(head: str, counts: Mapping[str, int]) -> str:
    named = [f"{count} {name.replace('_', ' ')}" for name, count in counts.items() if count]
    return f"{head} ({', '.join(named)})" if named else head
