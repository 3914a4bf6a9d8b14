"""The account of a decoded log as one JSON object."""

from dataclasses import asdict
from typing import Final

from canlog.decode.codec import FrameFate
from canlog.frames import EXTENDED_FLAG
from canlog.tables.account import Account
from canlog.tables.names import identifier_text
from canlog.tables.report import losses

JsonObject = dict[str, object]

SCHEMA: Final = "clutchdiag/decode/v1"
_BARE_ID: Final = 0x1FFF_FFFF


def account_record(account: Account) -> JsonObject:
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
                {**_identifier(one.can_id), "message": one.message, "message_id": _identifier(one.message_id)["id"]}
                for one in (() if account.known_count else account.nearest())
            ],
        },
        "messages": [_message(account, slot) for slot in account.seen_slots],
        "refused": account.refused,
        "overwritten": [{"message": old, "by": new} for old, new in account.overwritten],
        "losses": list(losses(account)),
    }


def _message(account: Account, slot: int) -> JsonObject:
    """Return one message that came, with all of its signals that were looked for."""
    message = account.codec.tables[slot].message
    fates = account.of_message(slot)
    return {
        "message": account.names.messages[slot],
        "id": identifier_text(message.frame_id, is_extended=message.is_extended_frame),
        "is_extended": message.is_extended_frame,
        "bytes": message.length,
        "frames": {fate.name.lower(): fates[fate] for fate in FrameFate if fate in fates},
        "signals": {
            name: {"column": account.names.columns[slot, name], **asdict(account.signals[slot, name])}
            for name in account.codec.tables[slot].signals
            if (slot, name) in account.signals
        },
    }


def _identifier(can_id: int) -> JsonObject:
    is_extended = bool(can_id & EXTENDED_FLAG)
    return {"id": identifier_text(can_id & _BARE_ID, is_extended=is_extended), "is_extended": is_extended}
