"""``diag-service signals``: what signals a log holds, and a profile proposed from them, as one TOML text."""

import sys
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from cantools.database.can import Message

from canlog.arrays import Int64Array
from canlog.decode.codec import Codec
from canlog.decode.signal_table import NO_INVALID, Decoded
from canlog.logs import read_log
from canlog.traffic import NS_PER_S
from dbc.contract import DBC_PATH
from diag_service.errors import StoppedError
from diag_service.mapping.databases import open_database
from diag_service.mapping.proposal import SignalStatistics, candidates, profile_text
from diag_service.mapping.tiers import PURPOSE, missing_for_next, tier_of
from diag_service.service.stopping import Controls, Trigger
from program_io.legible import legible


class _Range:
    """What the values of one signal were until now."""

    def __init__(self) -> None:
        self.count = 0
        self.lowest = np.inf
        self.highest = -np.inf
        self.is_integer = True
        self.invalid = NO_INVALID

    def add(self, decoded: Decoded) -> None:
        """Take more values."""
        self.invalid = self.invalid.plus(decoded.invalid)
        good = decoded.value if decoded.is_good is None else decoded.value[decoded.is_good]
        good = good[np.isfinite(good)]
        if len(good):
            self.count += len(good)
            self.lowest = min(self.lowest, float(good.min()))
            self.highest = max(self.highest, float(good.max()))
            self.is_integer &= bool(np.all(good == np.rint(good)))


class Survey:
    """The messages and signals of a log, with rates and ranges."""

    def __init__(self, codec: Codec) -> None:
        self._codec = codec
        self._ranges: dict[tuple[int, str], _Range] = {}
        self._counts: dict[int, int] = {}
        self._ends_ns: tuple[int, int] | None = None
        self.frames = 0
        self.is_cut = False
        self.unknown = 0

    def add(self, path: Path, stop: Trigger) -> None:
        """Take all frames of a log; raises StoppedError."""
        reader = read_log(path)
        for batch in reader:
            if stop.is_set:
                raise StoppedError("stopped early: no profile is proposed from a part of a log")
            if not len(batch):
                continue
            self._extend(batch.t_ns)
            self.frames += len(batch)
            self.unknown += len(batch)
            for found in self._codec.decode(batch):
                self.unknown -= len(found.rows)
                self._counts[found.slot] = self._counts.get(found.slot, 0) + len(found.rows)
                for name, decoded in found.signals.items():
                    self._ranges.setdefault((found.slot, name), _Range()).add(decoded)
        self.is_cut = reader.counts.truncated

    def messages(self) -> Iterator[tuple[Message, int, float]]:
        """Yield the messages that came, how often, and their rate [Hz]."""
        first_ns, last_ns = self._ends_ns or (0, 0)
        duration_s = (last_ns - first_ns) / NS_PER_S
        for slot, count in sorted(self._counts.items()):
            yield self._codec.tables[slot].message, count, (count - 1) / duration_s if duration_s else 0.0

    def statistics(self) -> list[SignalStatistics]:
        """Return the signals that came."""
        found = []
        for (slot, name), seen in sorted(self._ranges.items()):
            message = self._codec.tables[slot].message
            found.append(
                SignalStatistics(
                    message=message.name,
                    signal=name,
                    unit=self._codec.tables[slot].definitions[name].unit or "",
                    count=seen.count,
                    lowest=seen.lowest,
                    highest=seen.highest,
                    is_integer=seen.is_integer,
                    invalid=seen.invalid._asdict(),
                )
            )
        return found

    def _extend(self, t_ns: Int64Array) -> None:
        first_ns, last_ns = int(t_ns.min()), int(t_ns.max())
        before = self._ends_ns or (first_ns, last_ns)
        self._ends_ns = (min(before[0], first_ns), max(before[1], last_ns))


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Survey a log and write a profile whose comments say what there is."""
    database = options.dbc or DBC_PATH
    survey = Survey(Codec(open_database(options.dbc, is_lenient=options.lenient).messages, check_codes=True))
    survey.add(options.log, controls.stop)
    best = candidates(survey.statistics())
    tier = tier_of(best.keys())
    reach = f"tier {tier:d} ({PURPOSE[tier]})" if tier else "no tier"
    remarks = [
        f"Proposed for {options.log.name} and {database.name} by names, units and values: check every line.",
        f"As it stands it reaches {reach}. {missing_for_next(best.keys())}",
        "",
        *(["The log ends before its own end."] if survey.is_cut else []),
        f"{survey.frames} frames, {survey.unknown} of them of no message of the database.",
        *_listing(survey),
        "",
    ]
    sys.stdout.write(profile_text(legible(options.log.stem), best, [legible(remark) for remark in remarks]))


def _listing(survey: Survey) -> Iterator[str]:
    statistics = survey.statistics()
    for message, count, rate_hz in survey.messages():
        yield f"{message.name} ({message.frame_id:#x}): {count} frames, {rate_hz:.1f} Hz"
        for one in statistics:
            if one.message == message.name:
                span = f"{one.lowest:g} to {one.highest:g} {one.unit}".rstrip() if one.count else "no value"
                lost = "".join(
                    f", {count} values {reason.replace('_', ' ')}" for reason, count in one.invalid.items() if count
                )
                yield f"  {one.signal}: {span}{lost}"
