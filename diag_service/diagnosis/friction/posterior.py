"""What is known of one vehicle, as its events left it: friction, sensors, masses, films, all together.

One joint estimate of everything that a shift depends on. The last events are kept as what they say, not as samples, and
judged together; what is older has become part of the base. docs/model.md, section "Estimator".
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Final, Self

import numpy as np

from canlog.arrays import FloatArray
from clutch_model.calibration import Calibration
from clutch_model.gears import both_clutches, with_clutch
from diag_service.diagnosis.friction.drives import PackTemperatures
from diag_service.diagnosis.friction.evidence import (
    PARAMETER_COUNT,
    STATE_COUNT,
    Evidence,
    Fusion,
    Knowledge,
    State,
    friction_rows,
    fuse,
    prior_covariance,
    prior_mean,
)
from diag_service.diagnosis.friction.judgement import JudgedEvent, after_change, is_cheap, judge, together
from diag_service.diagnosis.plain_values import from_plain, to_plain
from fleet_contract import JsonObject

BASELINE_SHIFT_COUNT = 15  # of the clutch: three times the shifts that settle a verdict
SHAPES = {"mean": (2,), "covariance": (2, 2), "cross": (PARAMETER_COUNT, 2)}


@dataclass(frozen=True, slots=True, kw_only=True)
class Baseline:
    """Frozen ``(mu_c, mu_s)`` of one clutch, times the gain of the torque reading.

    ``cross`` is the covariance between the error of what is known today and that of the baseline. It begins as the
    baseline's own and fades as later shifts outweigh the earlier ones.
    """

    mean: FloatArray  # (2,)
    covariance: FloatArray  # (2, 2)
    cross: FloatArray  # (PARAMETER_COUNT, 2)
    end_ns: int  # bus time of the last shift in it
    shift_count: int  # shifts in it
    later_count: int = 0  # shifts that became part of the base since

    @classmethod
    def of(cls, clutch: int, known: Knowledge, *, end_ns: int, count: int) -> Self:
        rows = friction_rows(clutch)
        return cls(
            mean=known.mean[rows],
            covariance=known.covariance[rows, rows],
            cross=known.covariance[:, rows],
            end_ns=end_ns,
            shift_count=count,
        )

    def after(self, kept: FloatArray) -> Self:
        """Return the baseline after news of which this part of the earlier error is left."""
        return replace(self, cross=kept @ self.cross)


RECENT_COUNT: Final = 12  # events judged together: some six of each clutch
FRICTION_DRIFT_STD: Final = (
    2e-5  # per event: 0.15 in the life of a fluid is 1e-6, so this forgets over thousands of shifts
)
OFFSET_DRIFT_NM: Final = 0.005  # per event: warm-up of the torque model
PRESSURE_DRIFT_PA: Final = 5.0  # per event: warm-up of the pressure sensors
STATE_FORMAT: Final = 4
_LOWER: Final = np.tril_indices(PARAMETER_COUNT)
_STORED: Final = ("base", "folded_counts", "baselines", "packs")


def _drift() -> FloatArray:
    variance = np.zeros(PARAMETER_COUNT)
    variance[: State.TORQUE_OFFSET] = FRICTION_DRIFT_STD**2
    variance[State.TORQUE_OFFSET] = OFFSET_DRIFT_NM**2
    variance[State.TOUCH1 : STATE_COUNT] = PRESSURE_DRIFT_PA**2
    return variance


@dataclass(frozen=True, slots=True, kw_only=True)
class Posterior:
    """What is known of a vehicle; `fresh`, `with_event` and `from_json` make one."""

    base: Knowledge  # without the recent events
    recent: tuple[JudgedEvent, ...]  # the oldest first
    is_used: tuple[bool, ...]  # of the recent events: whether it belongs
    fusion: Fusion  # of the base and the recent events that belong
    folded_counts: tuple[int, int] = (0, 0)  # events in the base that speak of the friction of clutch 1 and 2
    baselines: tuple[Baseline | None, Baseline | None] = (None, None)  # against the base
    packs: PackTemperatures | None = None
    torque_gain: float = 1.0  # of the calibration: the parameters say by how much it is wrong
    stribeck_speed_rad_s: tuple[float, float] = (1.0, 1.0)  # likewise

    @classmethod
    def fresh(cls, calibration: Calibration) -> Self:
        """Return what is known of a vehicle before its first event: its calibration."""
        displacement = np.zeros(PARAMETER_COUNT - STATE_COUNT)
        mean = np.concatenate((prior_mean(calibration), displacement))
        return cls.of(Knowledge(mean=mean, covariance=prior_covariance(calibration)), calibration)

    @classmethod
    def of(cls, base: Knowledge, calibration: Calibration) -> Self:
        """Return what is known of a vehicle from somewhere else."""
        return cls(
            base=base,
            recent=(),
            is_used=(),
            fusion=fuse(base, Evidence.none()),
            torque_gain=calibration.bias.torque_gain,
            stribeck_speed_rad_s=both_clutches(one.friction.stribeck_speed_rad_s for one in calibration.clutches),
        )

    @property
    def known(self) -> Knowledge:
        """Everything that is known, with its uncertainty."""
        return self.fusion.knowledge

    @property
    def others(self) -> Knowledge:
        """What is known without the newest event."""
        return fuse(self.base, together(self.recent[:-1], self.is_used)).knowledge

    @property
    def shift_counts(self) -> tuple[int, int]:
        """Events that the friction of clutch 1 and 2 rests on."""
        used = [event.clutch for event, is_used in zip(self.recent, self.is_used, strict=True) if is_used]
        return both_clutches(self.folded_counts[m] + used.count(m + 1) for m in range(2))

    def warmed(self, packs: PackTemperatures) -> Self:
        """Return the same with the temperatures of both packs."""
        return replace(self, packs=packs)

    def with_event(self, event: JudgedEvent, room: "Posterior | None" = None) -> "Posterior":
        """Return what is known after an event, which all recent ones are judged with.

        ``room`` is what `with_room` returns, where that is known.
        """
        recent = (*self.recent, event)
        judged = judge(self.base, recent)
        state = replace(self, recent=recent, is_used=judged.is_used, fusion=judged.fusion)
        if judged.first_changed is not None:
            return _changed(state, judged.first_changed)
        if len(recent) <= RECENT_COUNT:
            return state
        if room is None or judged.is_used[0] != self.is_used[0]:
            room = _folded(state, 1)
        state = _together(replace(room, recent=recent[1:], is_used=judged.is_used[1:]))
        # Where all belong they do so beside an older base, too: it differs by the drift of one event.
        is_sure = all(judged.is_used) and is_cheap(state.fusion.chi_square, [one.evidence for one in state.recent])
        return state if is_sure else _judged(state)

    def with_room(self) -> "Posterior":
        """Return the same with room for one more event: of twelve the oldest is in the base, if it belongs as yet."""
        return self if len(self.recent) < RECENT_COUNT else _together(_folded(self, 1))

    def believes_as(self, room: "Posterior") -> bool:
        """Return whether of all but the newest event the same is believed as in ``room``, which it was judged with."""
        return self.base is room.base and self.is_used[:-1] == room.is_used

    def with_new_fluid(self) -> "Posterior":
        """Return the state after a fluid fill: friction is unknown again, and its baseline with it; the rest stays."""
        folded = _folded(self, len(self.recent))
        base = after_change(after_change(folded.base, 1), 2)
        return _judged(replace(folded, base=base, folded_counts=(0, 0), baselines=(None, None)))

    def later_count(self, clutch: int) -> int:
        """Return how many events have been used since the baseline of a clutch."""
        baseline = self.baselines[clutch - 1]
        recent_count = self.shift_counts[clutch - 1] - self.folded_counts[clutch - 1]
        return 0 if baseline is None else baseline.later_count + recent_count

    def cross(self, clutch: int) -> FloatArray:
        """Return the covariance between what is known now and the baseline of a clutch, which must have one."""
        baseline = self.baselines[clutch - 1]
        if baseline is None:
            raise ValueError(f"clutch {clutch} has no baseline")
        return self.fusion.kept @ baseline.cross

    def to_json(self) -> JsonObject:
        """Return the state as JSON-ready values; floats survive the round trip bit by bit."""
        plain = to_plain(replace(self, recent=(), is_used=()))
        stored = {name: plain[name] for name in _STORED}
        return {"format": STATE_FORMAT, "recent": [_stored(event) for event in self.recent]} | stored

    @classmethod
    def from_json(cls, table: Mapping[str, object], calibration: Calibration) -> "Posterior":
        """Rebuild a state saved by `to_json` under the same calibration.

        Raises
        ------
        ValueError
            If the table is not such a state.
        """
        if table.get("format") != STATE_FORMAT:
            raise ValueError(f"running state of format {table.get('format')!r}, expected {STATE_FORMAT}")
        blank = cls.fresh(calibration)
        try:
            kept = from_plain({name: table[name] for name in _STORED}, _Stored)
            recent = tuple(_restored(one) for one in _rows(table["recent"]))
        except (KeyError, TypeError, ValueError) as exc:
            raise ValueError(f"not a running state: {exc}") from exc
        shapes = {"mean": (PARAMETER_COUNT,), "covariance": (PARAMETER_COUNT, PARAMETER_COUNT)}
        for record, expected in ((kept.base, shapes), *((one, SHAPES) for one in kept.baselines if one is not None)):
            for name, shape in expected.items():
                value = getattr(record, name)
                if value.shape != shape or not np.all(np.isfinite(value)):
                    raise ValueError(f"not a running state: bad {name} of a {type(record).__name__}")
        return _judged(
            replace(
                blank,
                base=kept.base,
                recent=recent,
                folded_counts=kept.folded_counts,
                baselines=kept.baselines,
                packs=kept.packs,
            )
        )


def _together(state: Posterior) -> Posterior:
    """Return the state with what its base and those events say that are used."""
    return replace(state, fusion=fuse(state.base, together(state.recent, state.is_used)))


def _judged(state: Posterior) -> Posterior:
    judged = judge(state.base, state.recent)
    return replace(state, is_used=judged.is_used, fusion=judged.fusion)


def _changed(state: Posterior, first: int) -> Posterior:
    """Return the state after the friction of a clutch changed with the recent event in this place."""
    clutch = state.recent[first].clutch
    state = _folded(state, first)
    counts = with_clutch(state.folded_counts, clutch, 0)
    return _judged(replace(state, base=after_change(state.base, clutch), folded_counts=counts))


def _folded(state: Posterior, count: int) -> Posterior:
    """Return the state with the oldest recent events in the base, as far as they belong; its fusion stays as it was."""
    base, counts, baselines = state.base, state.folded_counts, state.baselines
    for event, used in zip(state.recent[:count], state.is_used, strict=False):
        if not used:
            continue
        news = fuse(base, event.evidence)
        base = news.knowledge.less_sure(_drift())
        baselines = both_clutches(one and one.after(news.kept) for one in baselines)
        counts = with_clutch(counts, event.clutch, counts[event.clutch - 1] + 1)
        shift_count, baseline = counts[event.clutch - 1], baselines[event.clutch - 1]
        if baseline is not None:
            baseline = replace(baseline, later_count=baseline.later_count + 1)
        elif shift_count >= BASELINE_SHIFT_COUNT:
            baseline = Baseline.of(event.clutch, base, end_ns=event.end_ns, count=shift_count)
        baselines = with_clutch(baselines, event.clutch, baseline)
    return replace(
        state,
        base=base,
        recent=state.recent[count:],
        is_used=state.is_used[count:],
        folded_counts=counts,
        baselines=baselines,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Stored:
    """The members of a state that are stored as they are."""

    base: Knowledge
    folded_counts: tuple[int, int]
    baselines: tuple[Baseline | None, Baseline | None]
    packs: PackTemperatures | None


@dataclass(frozen=True, slots=True, kw_only=True)
class _StoredEvent:
    """An event in a store: of the information matrix, which is symmetric, one half."""

    clutch: int
    end_ns: int
    lower: FloatArray
    vector: FloatArray
    constant: float
    count: int


def _stored(event: JudgedEvent) -> JsonObject:
    evidence = event.evidence
    return to_plain(
        _StoredEvent(
            clutch=event.clutch,
            end_ns=event.end_ns,
            lower=evidence.matrix[_LOWER],
            vector=evidence.vector,
            constant=evidence.constant,
            count=evidence.count,
        )
    )


def _rows(value: object) -> Iterable[object]:
    if not isinstance(value, list) or len(value) > RECENT_COUNT:
        raise ValueError("recent must be a list of at most 12 events")
    return value


def _restored(table: object) -> JudgedEvent:
    stored = from_plain(table, _StoredEvent)
    if (
        stored.lower.shape != (len(_LOWER[0]),)
        or stored.vector.shape != (PARAMETER_COUNT,)
        or stored.clutch not in {1, 2}
    ):
        raise ValueError("an event of another kind")
    numbers = np.concatenate((stored.lower, stored.vector, [stored.constant]))
    if not np.all(np.isfinite(numbers)):
        raise ValueError("an event that is not finite")
    matrix = np.zeros((PARAMETER_COUNT, PARAMETER_COUNT))
    matrix[_LOWER] = stored.lower
    return JudgedEvent(
        clutch=stored.clutch,
        end_ns=stored.end_ns,
        evidence=Evidence(
            matrix=matrix + np.tril(matrix, -1).T, vector=stored.vector, constant=stored.constant, count=stored.count
        ),
    )
