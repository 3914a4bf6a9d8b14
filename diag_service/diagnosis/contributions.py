"""What each log of a drive, and each channel in it, gave to a run; and which gave nothing."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields
from typing import Self

from fleet_contract import JsonObject

OTHER_CHANNEL = "other_channel"
OF_NO_MESSAGE = "remote_or_error"  # the only rejection that says nothing of a message


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameShare:
    """What became of some frames: ``frames = decoded + ignored + sum(rejected.values())``, to the frame."""

    frames: int  # that were looked at
    decoded: int
    ignored: int  # of messages that are not used
    rejected: Mapping[str, int] = field(default_factory=dict)  # reason -> frames


@dataclass(frozen=True, slots=True, kw_only=True)
class ChannelShare(FrameShare):
    """What one channel of a log gave."""

    channel: int  # as its log numbers it

    @property
    def is_passed_over(self) -> bool:
        """Whether messages that are wanted came here, and not one frame of them was used."""
        return not self.decoded and any(self.rejected[reason] for reason in self.rejected if reason != OF_NO_MESSAGE)


@dataclass(frozen=True, slots=True, kw_only=True)
class LogShare(FrameShare):
    """What one log gave: the sum of its channels."""

    path: str
    channels: tuple[ChannelShare, ...]  # by number

    @classmethod
    def of(cls, path: str, channels: tuple[ChannelShare, ...]) -> Self:
        rejected: Counter[str] = Counter()
        for one in channels:
            rejected.update(one.rejected)
        frames, decoded, ignored = (
            sum(getattr(one, name) for one in channels) for name in ("frames", "decoded", "ignored")
        )
        return cls(frames=frames, decoded=decoded, ignored=ignored, rejected=rejected, path=path, channels=channels)

    @property
    def used_channels(self) -> tuple[int, ...]:
        return tuple(one.channel for one in self.channels if one.decoded)


@dataclass(frozen=True, slots=True, kw_only=True)
class Contributions:
    """What the logs of a drive gave."""

    logs: tuple[LogShare, ...] = ()  # none for a bus
    idle: tuple[str, ...] = ()  # what gave nothing, each on a line for people


NO_LOGS = Contributions()


def idle_lines(logs: Sequence[LogShare], named_channel: int | None) -> Iterator[str]:
    """Yield a line for each log of which not one frame was used, and for channels with wanted messages of each other.

    A profile that names its channel passes the others over on purpose; a log without the named one gives nothing.
    """
    for log in logs:
        if not log.decoded:
            yield f"{log.path} contributed nothing: {_log_fate(log, logs, named_channel)}"
        elif named_channel is None and (passed := tuple(one for one in log.channels if one.is_passed_over)):
            more = f" and {len(passed) - 1} more" if len(passed) > 1 else ""  # a damaged log may have hundreds
            fate = _fate_text(LogShare.of(log.path, passed), "of messages that are followed elsewhere")
            yield f"channel {passed[0].channel}{more} of {log.path} contributed nothing: {fate}"


def log_record(log: LogShare) -> JsonObject:
    return {
        "path": log.path,
        "followed_channels": list(log.used_channels),
        **_counts(log),
        "channels": [{"channel": one.channel, **_counts(one)} for one in log.channels],
    }


def _counts(share: FrameShare) -> JsonObject:
    return {one.name: getattr(share, one.name) for one in fields(FrameShare)}


def _log_fate(log: LogShare, logs: Sequence[LogShare], named_channel: int | None) -> str:
    """Return in words what became of the frames of a log of which none was used."""
    elsewhere = [one for one in log.channels if one.rejected.get(OTHER_CHANNEL)]
    own = {one.channel for one in elsewhere}
    if named_channel is not None:
        wanted = f"the profile names {named_channel}"
    else:
        used = {channel for other in logs for channel in other.used_channels}
        wanted = f"the drive follows {_listed(used - own)}" if used - own else "the drive follows those of other logs"
    return _fate_text(log, f"on another channel ({_listed(own)}; {wanted})")


def _fate_text(share: FrameShare, elsewhere: str) -> str:
    counts = {elsewhere: share.rejected.get(OTHER_CHANNEL, 0), "of messages that are not used": share.ignored}
    counts |= {
        f"rejected: {reason.replace('_', ' ')}": count
        for reason, count in share.rejected.items()
        if reason != OTHER_CHANNEL
    }
    return ", ".join(f"{count} frames {words}" for words, count in counts.items() if count) or "no frame was read"


def _listed(channels: Iterable[int]) -> str:
    return ", ".join(map(str, sorted(channels)))
