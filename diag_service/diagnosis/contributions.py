"""What each log of a drive, and each channel in it, gave to a run; and which gave nothing."""

from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field

from fleet_contract import JsonObject

OTHER_CHANNEL = "other_channel"
OF_NO_MESSAGE = "remote_or_error"  # the only rejection that says nothing of a message


@dataclass(frozen=True, slots=True, kw_only=True)
class ChannelShare:
    """What one channel of a log gave: ``frames = decoded + ignored + sum(rejected.values())``, to the frame."""

    channel: int  # as its log numbers it
    frames: int
    decoded: int
    ignored: int  # of messages that are not used
    rejected: Mapping[str, int] = field(default_factory=dict)  # reason -> frames

    @property
    def is_passed_over(self) -> bool:
        """Whether messages that are wanted came here, and not one frame of them was used."""
        return not self.decoded and any(self.rejected[reason] for reason in self.rejected if reason != OF_NO_MESSAGE)


@dataclass(frozen=True, slots=True, kw_only=True)
class LogShare:
    """What one log gave: the sum of its channels."""

    path: str
    channels: tuple[ChannelShare, ...]  # by number

    @property
    def frames(self) -> int:
        """Frames that were looked at."""
        return sum(one.frames for one in self.channels)

    @property
    def decoded(self) -> int:
        """Frames that were used."""
        return sum(one.decoded for one in self.channels)

    @property
    def ignored(self) -> int:
        """Frames of messages that are not used."""
        return sum(one.ignored for one in self.channels)

    @property
    def rejected(self) -> Mapping[str, int]:
        """Frames that were not used, by reason."""
        total: Counter[str] = Counter()
        for one in self.channels:
            total.update(one.rejected)
        return dict(total)

    @property
    def used_channels(self) -> tuple[int, ...]:
        """The channels from which frames were used."""
        return tuple(one.channel for one in self.channels if one.decoded)


@dataclass(frozen=True, slots=True, kw_only=True)
class Contributions:
    """What the logs of a drive gave."""

    logs: tuple[LogShare, ...] = ()  # none for a bus
    idle: tuple[str, ...] = ()  # what gave nothing, each on a line for people


NO_LOGS = Contributions()


def idle_lines(logs: Sequence[LogShare], named_channel: int | None) -> Iterator[str]:
    """Yield a line for each log, and each channel with messages that are wanted, of which not one frame was used.

    A profile that names its channel passes the others over on purpose; a log without the named one gives nothing.
    """
    for log in logs:
        if not log.decoded:
            yield f"{log.path} contributed nothing: {_log_fate(log, logs, named_channel)}"
        elif named_channel is None:
            for one in log.channels:
                if one.is_passed_over:
                    yield f"channel {one.channel} of {log.path} contributed nothing: {_channel_fate(one)}"


def log_record(log: LogShare) -> JsonObject:
    """Return the share of a log as a JSON object."""
    return {
        "path": log.path,
        "followed_channels": list(log.used_channels),
        **_counts(log),
        "channels": [{"channel": one.channel, **_counts(one)} for one in log.channels],
    }


def _counts(share: LogShare | ChannelShare) -> JsonObject:
    return {
        "frames": share.frames,
        "decoded": share.decoded,
        "ignored": share.ignored,
        "rejected": dict(share.rejected),
    }


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


def _channel_fate(one: ChannelShare) -> str:
    return _fate_text(one, "of messages that are followed elsewhere")


def _fate_text(share: LogShare | ChannelShare, elsewhere: str) -> str:
    counts = {elsewhere: share.rejected.get(OTHER_CHANNEL, 0), "of messages that are not used": share.ignored}
    counts |= {
        f"rejected: {reason.replace('_', ' ')}": count
        for reason, count in share.rejected.items()
        if reason != OTHER_CHANNEL
    }
    return ", ".join(f"{count} frames {words}" for words, count in counts.items() if count) or "no frame was read"


def _listed(channels: Iterable[int]) -> str:
    return ", ".join(map(str, sorted(channels)))
