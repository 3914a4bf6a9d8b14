"""Whether causes are told apart: lives of cars that are driven through all gears, sound at first, then with a fault.

Vehicles, loads and temperatures are drawn, and so is how a cause shows in a car. After forty events a cause begins, at
once or over some drives; a hundred events later the service is asked. A wrong fluid comes with a fill. Judged are each
cause, sound cars, pairs, and faults that no signature knows, and how reliable the stated probabilities are.

    python -m studies.causes --lives 8 --seed 700000 --workers 1
    python -m studies.causes --lives 70 --seed 820000 --only unknown sound --workers 2
    python -m studies.causes --other-laws --lives 3             # cars whose film, spring, drag, ... nobody has told
    python -m studies.causes --left-out --lives 5 --seed 870000  # cars of a law that the signatures have not seen
    python -m studies.causes --fit --lives 12 --seed 600000      # writes the signatures, from lives drawn wider
"""

import sys
import tomllib
from collections import Counter, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Final, NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

import diag_service
from canlog.arrays import FloatArray
from clutch_model.calibration import nominal_calibration
from diag_service.diagnosis.condition.causes import ELSE, FEATURES, MIRRORED, SOUND, CauseJudge, described
from diag_service.diagnosis.condition.condition import LEAST_COUNT, VehicleCourse
from ecu_emulator.drive.build import build_vehicle
from ecu_emulator.drive.recording import frames_of
from ecu_emulator.scenario.faults import CauseKind, Degradation
from ecu_emulator.scenario.scenario import Ambient, Driver, Effects, Scenario
from studies.builders import new_stages, to_batch
from studies.run import over_drives, parsed, study_parser

FIRST_SEED: Final = 700_000  # below 700000 signatures were fitted and settings were chosen
LEFT_OUT_SEED: Final = 660_000  # of lives to fit to all laws but one
UNSEEN: Final = frozenset({CauseKind.SYNCHRONISER, CauseKind.DRAGGING_CLUTCH})  # no signal of a shift shows them well
TOLD: Final = [kind for kind in CauseKind if kind not in UNSEEN]
UNKNOWN: Final = (  # what no signature knows
    Effects(stribeck_speed_ratio=1.7),
    Effects(stribeck_speed_ratio=0.55),
    Effects(contact_stiffness_ratio=2.5),
    Effects(friction_fade_per_k=0.004),
    Effects(piston_area_ratio=0.92),
    Effects(motoring_torque_ratio=1.4),
)
PAIRED: Final = (  # of each a few lives, drawn by seed
    (CauseKind.AGED_FLUID, CauseKind.WORN_LINING), (CauseKind.WATER, CauseKind.GLAZED_LINING),
    (CauseKind.GLAZED_LINING, CauseKind.WEAK_PUMP), (CauseKind.AIR, CauseKind.RETURN_SPRING),
    (CauseKind.PRESSURE_SENSOR, CauseKind.AGED_FLUID), (CauseKind.TORQUE_SENSOR, CauseKind.WORN_LINING),
)  # fmt: skip
SOUND_DRIVES, FAULTY_DRIVES = 4, 10  # of ten events each
MOST_RAMP: Final = 3  # drives over which a cause grows
RELEVANT: Final = 2.0  # strengths that are judged
FIT_STRENGTHS: Final = (0.8, 3.2)
BETWEEN_NS: Final = 3_600_000_000_000
FILLED_AT: Final = "2026-01-01T12:00:00.000000Z"
LEAST_FIRST, LEAST_SECOND, MOST_SURE_WRONG, MOST_ERROR, MOST_ACCUSED = 0.80, 0.92, 0.02, 0.05, 0.01
LEAST_PAIRS, LEAST_UNKNOWN = 0.70, 0.80
SURE: Final = 0.9
UNSAID: Final = "nothing said"  # with too few events since friction changed
GROUPS: Final = ("single", SOUND, "pairs", "unknown")
LEAST_FLOORS: Final = {  # by which any sound car may move, by the beginning of a name: controls adapt, oils differ [C]
    "level": 0.005, "slope": 0.0068, "torque_offset": 0.4, "touch": 1e3, "zero": 5e2, "torque_gain": 0.004,
    "engine_inertia": 0.005, "piston_area": 0.001, "viscosity": 0.03, "torque_latency": 5e-4, "pressure_latency": 8e-4,
    "motoring_gain": 0.01, "stribeck": 0.04, "contact_stiffness": 0.02, "film_mobility": 0.1, "friction_temp": 2e-4,
    "open_drag": 0.15, "pressure_lag": 8e-4, "pressure_reach": 5e-3, "pressure_short": 1.5e3, "fill_time": 7e-3,
    "believed_touch": 1e3, "scatter": 0.1,
}  # fmt: skip
WANDER_PERCENTILE: Final = 75.0
FEW, USUAL_SPREAD = 4, 0.25  # lives that count for a spread of so much of the mean: of a few more is not known
WIDER: Final = 1.5  # spreads against those of the fitted fleet: no plant is another's
SIGNATURES: Final = Path(diag_service.__file__).with_name("diagnosis") / "condition/signatures.toml"


@dataclass(frozen=True, slots=True, kw_only=True)
class CauseLife:
    """One car and what becomes of it."""

    seed: int
    kinds: tuple[CauseKind, ...] = ()
    unknown: int | None = None  # place in UNKNOWN
    strength: float = RELEVANT
    laws: tuple[str, ...] = ()  # of LAWS: in what the car is another than its type, from the beginning


@dataclass(frozen=True, slots=True, kw_only=True)
class CauseLived:
    """What the service has seen and said at its end."""

    life: CauseLife
    truths: tuple[tuple[str, int | None, float], ...]  # cause, clutch, and which way
    moments: tuple[VehicleCourse, ...]  # sound and grown, of the last one all events


def _factor(rng: np.random.Generator, most: float) -> float:
    return float(np.exp(rng.uniform(-np.log(most), np.log(most))))


LAWS: Final[Mapping[str, Callable[[np.random.Generator], Effects]]] = {
    "film": lambda rng: Effects(film_mobility_ratio=_factor(rng, 3.0), viscosity_ratio=_factor(rng, 1.2)),
    "spring": lambda rng: Effects(contact_stiffness_ratio=_factor(rng, 1.4), spring_force_n=rng.uniform(-25.0, 25.0)),
    "drag": lambda rng: Effects(open_drag_ratio=_factor(rng, 3.0), open_drag_limit_nm=rng.choice([0.0, 4.0, 15.0])),
    "lining": lambda rng: Effects(stribeck_speed_ratio=_factor(rng, 1.35), friction_fade_per_k=rng.uniform(0.0, 0.002)),
    "sensors": lambda rng: Effects(motoring_torque_ratio=_factor(rng, 1.1), piston_area_ratio=_factor(rng, 1.01)),
}


def effects_of(life: CauseLife, share: float) -> Effects:
    """Return what is true of a car from the beginning, and of what no signature knows if a share of it is there."""
    drawn = [LAWS[law](np.random.default_rng([life.seed, place])) for place, law in enumerate(life.laws)]
    if life.unknown is not None and share > 0.0:
        drawn.append(UNKNOWN[life.unknown])
    changed: dict[str, Any] = {name: value for one in drawn for name, value in one.switched_on().items()}
    return Effects(**changed)


def scenario_of(life: CauseLife, drive: int, share: float, rng: np.random.Generator) -> Scenario:
    """Return one drive of a life."""
    oil_k = float(rng.uniform(343.0, 373.0))
    causes = tuple(Degradation(kind=kind, strength=life.strength * share) for kind in life.kinds if share > 0.0)
    return Scenario(
        name="life",
        vehicle_seed=life.seed,
        drive_seed=life.seed * 100 + drive,
        driver=Driver(pedal_ratio=float(rng.uniform(0.35, 0.6))),
        ambient=Ambient(oil_temperature_k=oil_k, coolant_temperature_k=min(oil_k, float(rng.uniform(340.0, 360.0)))),
        causes=causes,
        effects=effects_of(life, share),
    )


def lived(life: CauseLife) -> list[CauseLived]:
    """Drive a life and have it diagnosed."""
    rng = np.random.default_rng(life.seed)
    stages = new_stages()
    has_fill = CauseKind.WRONG_FLUID in life.kinds
    ramp = 0 if has_fill else int(rng.integers(0, MOST_RAMP + 1))
    moments, offset_ns = list[VehicleCourse](), 0
    scenario = scenario_of(life, 0, 0.0, rng)
    for drive in range(SOUND_DRIVES + ramp + FAULTY_DRIVES):
        if has_fill and drive == SOUND_DRIVES:
            stages.note_fluid(FILLED_AT)
        share = min(max((drive - SOUND_DRIVES + 1) / (ramp + 1), 0.0), 1.0)
        scenario = scenario_of(life, drive, share, rng)
        batch = to_batch(frames_of(scenario)[0])
        batch = replace(batch, t_ns=batch.t_ns + offset_ns)
        offset_ns += int(batch.t_ns[-1] - batch.t_ns[0]) + BETWEEN_NS
        for event in (*stages.segment(batch), *stages.flush()):
            stages.conclude(event)
        if drive - SOUND_DRIVES - ramp + 1 in {1, 4, 7, FAULTY_DRIVES}:
            moments.append(stages.belief.memory.course)
    truths = tuple(
        (one.kind, one.clutch, 1.0 if next(iter(one.changes.values())) > 1.0 else -1.0)
        for one in build_vehicle(scenario).causes
    )
    return [CauseLived(life=life, truths=truths, moments=tuple(moments))]


def fitted(lives: Sequence[CauseLived]) -> dict[str, Any]:
    """Return floors and signatures by lives: moments, less what the stated deviations explain."""
    words = {name: value for name, value in described().items() if name not in {"floor", "moves"}}
    words["cause"] = {kind: told for kind, told in words["cause"].items() if "opposite_of" not in told}
    blank = {**words, "floor": {}, "moves": {kind: {} for kind in words["cause"]}}
    judge = CauseJudge(nominal_calibration(), blank)
    sound = [judge.change(course.begun, course.now) for one in lives if not one.truths and one.life.unknown is None
             for course in one.moments[1:]]  # fmt: skip
    moved, stated = np.array([one.mean for one in sound]), np.array([one.covariance.diagonal() for one in sound])
    usual = np.median(stated, axis=0)  # one car that tells next to nothing is not what any may do
    extra = np.maximum((moved**2).mean(axis=0) - stated.mean(axis=0), 0.02 * usual)
    least = [next((value for stem, value in LEAST_FLOORS.items() if name.startswith(stem)), 0.0) for name in FEATURES]
    floors = dict(zip(FEATURES, map(_rounded, np.maximum(np.sqrt(extra), least)), strict=True))
    judge = CauseJudge(nominal_calibration(), {**blank, "floor": floors})
    rows: dict[str, list[tuple[FloatArray, FloatArray]]] = {kind: [] for kind in words["cause"]}
    for one in lives:
        for kind, clutch, sign in [truth for truth in one.truths if truth[0] in rows][:1]:
            told = words["cause"][kind]
            change = judge.change(one.moments[-1].begun, one.moments[-1].now)
            scale = one.life.strength * np.maximum(change.shown, 1e-3) * (sign if told["is_either_way"] else 1.0)
            order = MIRRORED if clutch == 2 and told["is_of_one_clutch"] else slice(None)
            noise = np.where(change.shown > 0.0, change.covariance.diagonal() / scale**2, np.inf)
            rows[kind].append(((change.mean / scale)[order], noise[order]))
    fits = {kind: mean_of(some) for kind, some in rows.items()}
    away = [(value - fits[kind].mean) ** 2 - noise for kind, some in rows.items() for value, noise in some]
    wander = np.percentile(np.maximum(away, 0.0), WANDER_PERCENTILE, axis=0)  # of what a cause does not move by itself
    moves: dict[str, dict[str, list[float]]] = {}
    for kind, (mean, own, noise, life_count) in fits.items():
        typical = np.sqrt(noise)
        error, signal = np.sqrt(np.maximum(own, noise) / life_count), np.abs(mean) / typical
        usual = wander * min(signal.max(), 1.0) ** 2 + (USUAL_SPREAD * mean) ** 2
        spread = np.sqrt((np.maximum(own - noise, 0.0) * life_count + FEW * usual) / (life_count + FEW))
        is_moved = ((np.abs(mean) > 2.5 * error) & (signal > 0.25)) | (signal == signal.max())
        moves[kind] = {
            FEATURES[place]: [_rounded(mean[place] * is_moved[place]), _rounded(WIDER * spread[place])]
            for place in np.flatnonzero(is_moved | (spread > 0.2 * typical))
        }
    return {"floor": floors, "moves": moves}


def written(table: dict[str, Any]) -> str:
    """Return floors and signatures as a file, a line each."""
    lines = ["# What causes move by a strength of 1: mean and deviation. Written by python -m studies.causes --fit"]
    for title, rows in (("floor", table["floor"]), *((f"moves.{kind}", rows) for kind, rows in table["moves"].items())):
        lines += ["", f"[{title}]", *(f"{name} = {value}" for name, value in rows.items())]
    return "\n".join((*lines, ""))


class MeanMove(NamedTuple):
    """What some lives moved, each (COUNT,)."""

    mean: FloatArray
    variance: FloatArray  # from life to life
    noise: FloatArray  # variance of what a single one tells
    life_count: FloatArray  # of those that tell it, at least 1


def mean_of(rows: Sequence[tuple[FloatArray, FloatArray]]) -> MeanMove:
    """Return what some lives moved, the better known ones counting more; what one does not tell has infinite noise."""
    values = np.array([value for value, _ in rows])
    noise = np.ma.masked_invalid([noise for _, noise in rows])
    life_count = np.maximum(noise.count(axis=0), 1)
    weights = 1.0 / (noise + np.ma.median(noise, axis=0))  # type: ignore[no-untyped-call]
    weights /= weights.sum(axis=0)
    mean = (weights * values).sum(axis=0).filled(0.0)
    own = (weights * (values - mean) ** 2).sum(axis=0).filled(0.0) * life_count / np.maximum(life_count - 1, 1)
    return MeanMove(mean, own, (weights * noise).sum(axis=0).filled(np.inf), life_count)


def _rounded(value: float) -> float:
    return float(f"{value:.2e}")


@dataclass(frozen=True, slots=True, kw_only=True)
class CauseOutcome:
    """What was stated of one life."""

    life: CauseLife
    truths: frozenset[tuple[str, int | None]]
    stated: tuple[tuple[str, int | None, float], ...]  # the likeliest first
    accused: bool  # at any moment something else than sound was likelier than not

    @classmethod
    def of(cls, one: CauseLived, judge: CauseJudge) -> "CauseOutcome":
        """Return what the service states of a life; where a clutch is not told, the truth does not tell it either."""
        found = [judge.judge(course) if course.now.count >= LEAST_COUNT else None for course in one.moments]
        with_clutch = {kind for kind, told in described()["cause"].items() if told["is_of_one_clutch"]}
        sound = [
            sum(cause.probability for cause in causes.likely if cause.cause == SOUND) for causes in found if causes
        ]
        last = found[-1].likely if found[-1] else ()
        return cls(
            life=one.life,
            truths=frozenset((kind, clutch if kind in with_clutch else None) for kind, clutch, _ in one.truths),
            stated=tuple((cause.cause, cause.clutch, cause.probability) for cause in last) or ((UNSAID, None, 0.0),),
            accused=min(sound, default=1.0) < 0.5,
        )

    def is_among(self, count: int) -> bool:
        """Return whether all that is wrong is among the first so many."""
        return self.truths <= {(cause, clutch) for cause, clutch, _ in self.stated[:count]}

    @property
    def is_unsure(self) -> bool:
        cause, _, probability = self.stated[0]
        return cause == ELSE or probability < SURE

    @property
    def is_sure_and_wrong(self) -> bool:
        cause, clutch, probability = self.stated[0]
        nothing = SOUND if self.life.unknown is None else ELSE
        return probability >= SURE and (cause, clutch) not in (self.truths or {(nothing, None)})


def reliability(outcomes: Sequence[CauseOutcome]) -> tuple[Table, float]:
    """Return stated probabilities against how often they come true, and the mean distance of both."""
    table = Table("stated", "count", "mean", "true", title="Stated probabilities")
    pairs = [
        (probability, (cause, clutch) in (one.truths or {(SOUND, None)}))
        for one in outcomes
        for cause, clutch, probability in one.stated
        if cause != UNSAID
    ]
    error = 0.0
    for low, high in pairwise((0.0, 0.02, 0.1, 0.3, 0.5, 0.7, 0.9, 0.98, 1.01)):
        some = np.array([pair for pair in pairs if low <= pair[0] < high], dtype=float)
        if len(some):
            mean, true = some.mean(axis=0).tolist()
            error += len(some) / len(pairs) * abs(mean - true)
            table.add_row(f"{low:.2f} to {min(high, 1.0):.2f}", str(len(some)), f"{mean:.3f}", f"{true:.3f}")
    return table, error


def confusion(outcomes: Sequence[CauseOutcome]) -> Table:
    """Return by cause how many lives were told right, and what the others were taken for."""
    table = Table("cause", "lives", "first", "first two", "sure", "sure and wrong", "taken for", title="By cause")
    kinds: dict[str, list[CauseOutcome]] = defaultdict(list)
    for one in outcomes:
        kinds[
            " + ".join(sorted(kind for kind, _ in one.truths)) or ("unknown" if one.life.unknown is not None else SOUND)
        ].append(one)
    for kind, some in kinds.items():
        first, second = (sum(one.is_among(count) for one in some) for count in (1, 2))
        if kind == SOUND:
            first = second = sum(one.stated[0][0] == SOUND for one in some)
        sure, wrong = sum(one.stated[0][2] >= SURE for one in some), sum(one.is_sure_and_wrong for one in some)
        taken = Counter(
            f"{one.stated[0][0]}{one.stated[0][1] or ''}" for one in some if not one.is_among(1) or not one.truths
        )
        table.add_row(
            kind,
            str(len(some)),
            *map(str, (first, second, sure, wrong)),
            ", ".join(f"{count} {name}" for name, count in taken.items()),
        )
    return table


def group_of(life: CauseLife) -> str:
    """Return what a life is judged with."""
    return "unknown" if life.unknown is not None else (SOUND, "single", "pairs")[len(life.kinds)]


def lives_to_judge(count: int, seed: int) -> Iterator[CauseLife]:
    """Yield as many lives of each cause, of sound cars, pairs and what is unknown twice as many, in turns."""
    for turn in range(count):
        for place, kinds in enumerate((*((kind,) for kind in TOLD), (), ())):
            yield CauseLife(seed=seed + turn * (len(TOLD) + 2) + place, kinds=kinds)
        for number in (2 * turn, 2 * turn + 1):
            yield CauseLife(seed=seed + 5_000 + number, kinds=PAIRED[number % len(PAIRED)])
            yield CauseLife(seed=seed + 8_000 + number, unknown=number % len(UNKNOWN))


def lives_to_fit(count: int, seed: int) -> Iterator[CauseLife]:
    """Yield lives with strengths drawn wider than those that are judged, and sound ones."""
    rng = np.random.default_rng(seed)
    for number in range(count * (len(TOLD) + 2)):
        place = number % (len(TOLD) + 2)
        kinds = (TOLD[place],) if place < len(TOLD) else ()
        yield CauseLife(seed=seed + number, kinds=kinds, strength=float(rng.uniform(*FIT_STRENGTHS)))


def by_turns(lives: Iterable[CauseLife]) -> list[CauseLife]:
    """Return lives of cars that are other than their type by one law each, all laws in turns."""
    names, kinds = tuple(LAWS), len(TOLD) + 2
    return [replace(life, laws=(names[(k + k // kinds) % len(names)],)) for k, life in enumerate(lives)]


def judged_unseen(fits: Sequence[CauseLived], found: Sequence[CauseLived]) -> Iterator[CauseOutcome]:
    """Yield what is stated of each life by signatures that were fitted to cars of all other laws."""
    for law in LAWS:
        judge = judge_of(written(fitted([one for one in fits if law not in one.life.laws])))
        yield from (CauseOutcome.of(one, judge) for one in found if law in one.life.laws)


def judge_of(signatures: str) -> CauseJudge:
    """Return a judge by the text of a file of signatures."""
    return CauseJudge(nominal_calibration(), {**described(), **tomllib.loads(signatures)})


def judged(outcomes: Sequence[CauseOutcome], console: Console) -> bool:
    """Print all tables; return whether everything that is asked for was reached."""
    console.print(confusion(outcomes))
    single, sound, pairs, unknown = ([one for one in outcomes if group_of(one.life) == group] for group in GROUPS)
    reached = [
        ("top cause right", [one.is_among(1) for one in single], LEAST_FIRST, True),
        ("among the first two", [one.is_among(2) for one in single], LEAST_SECOND, True),
        ("sure and wrong", [one.is_sure_and_wrong for one in single], MOST_SURE_WRONG, False),
        ("sound accused at any moment", [one.accused for one in sound], MOST_ACCUSED, False),
        ("both of a pair among the first three", [one.is_among(3) for one in pairs], LEAST_PAIRS, True),
        ("unknown: something else, or unsure", [one.is_unsure for one in unknown], LEAST_UNKNOWN, True),
    ]  # fmt: skip
    shares = [(name, share(said), limit, is_least) for name, said, limit, is_least in reached if said]
    if single and sound:
        diagram, error = reliability([*single, *sound, *pairs])
        console.print(diagram)
        shares.append(("distance of stated and true", error, MOST_ERROR, False))
    is_all = True
    for name, value, limit, is_least in shares:
        is_met = value >= limit if is_least else value <= limit
        is_all &= is_met
        console.print(
            f"{name}: {value:.1%}, {'at least' if is_least else 'at most'} {limit:.0%}: {'met' if is_met else 'FAILED'}"
        )
    return is_all


def share(some: Iterable[bool]) -> float:
    """Return which share of some is true."""
    counted = list(some)
    return sum(counted) / max(len(counted), 1)


def main() -> int:
    """Live all lives and print what was told of them, or fit signatures; return 1 if anything was not reached."""
    parser = study_parser(__doc__, seed=FIRST_SEED)
    parser.add_argument("--lives", type=int, default=8, help="of each cause")
    parser.add_argument("--only", nargs="+", choices=GROUPS, default=GROUPS, help="lives of these alone")
    parser.add_argument("--fit", action="store_true", help="write the signatures instead")
    parser.add_argument("--signatures", type=Path, default=SIGNATURES, help="to be written or used (those that ship)")
    parser.add_argument(
        "--other-laws", nargs="*", choices=LAWS, help="cars are other than their type: by these laws, or by all"
    )
    parser.add_argument("--left-out", action="store_true", help="each law judged by signatures of all other laws' cars")
    options = parsed(parser, lives=1, only=(SOUND, "pairs"))
    lives = list((lives_to_fit if options.fit else lives_to_judge)(options.lives, options.seed))
    laws = () if options.other_laws is None else tuple(options.other_laws or LAWS)
    lives = [replace(life, laws=laws) for life in lives if group_of(life) in options.only]
    if options.left_out:
        fits = by_turns(lives_to_fit(2 * options.lives, LEFT_OUT_SEED))
        lives = by_turns(life for life in lives if group_of(life) in {"single", SOUND})
        found = over_drives(lived, [*fits, *lives], options.workers, options.kept)
        outcomes = list(judged_unseen(found[: len(fits)], found[len(fits) :]))
        return 0 if judged(outcomes, Console(markup=False, width=160)) else 1
    found = over_drives(lived, lives, options.workers, options.kept)
    if options.fit:
        options.signatures.write_text(written(fitted(found)), encoding="utf-8")
        return 0
    judge = judge_of(options.signatures.read_text("utf-8"))
    return 0 if judged([CauseOutcome.of(one, judge) for one in found], Console(markup=False, width=160)) else 1


if __name__ == "__main__":
    sys.exit(main())
