"""What a transmission is made of: shafts, gear pairs, planetary sets, friction elements, and what each gear applies.

A description states the parts; ratios, what each element carries, and which two speeds make its slip follow from them.
docs/model.md, section "Transmissions".
"""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, NamedTuple, Self

import numpy as np

from clutch_model.calibration import calibration_table
from clutch_model.errors import CalibrationError
from clutch_model.tables import record_from, require
from clutch_model.units import FloatArray

HOUSING: Final = "housing"  # the shaft that never turns
FORMAT: Final = 1
MOST_RATIO_ERROR: Final = 2e-3  # of a stated ratio: published ones have three digits
LEAST_LEVER: Final = 0.05  # an element that moves the input less says nothing of its friction
_ROUNDING: Final = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanetarySet:
    """Three shafts whose speeds obey Willis' equation."""

    sun: str
    ring: str
    carrier: str
    sun_teeth: int
    ring_teeth: int

    def row(self, place: Mapping[str, int]) -> FloatArray:
        """Return what is zero of the speeds, shape (shafts,)."""
        both = self.sun_teeth + self.ring_teeth
        return _row(place, {self.sun: self.sun_teeth, self.ring: self.ring_teeth, self.carrier: -both})


@dataclass(frozen=True, slots=True, kw_only=True)
class GearPair:
    """Two shafts that turn together while a synchroniser holds them: the first one ``ratio`` times as fast."""

    name: str
    between: tuple[str, str]
    ratio: float

    def row(self, place: Mapping[str, int]) -> FloatArray:
        """Return what is zero of the speeds, shape (shafts,)."""
        return _row(place, {self.between[0]: 1.0, self.between[1]: -self.ratio})


@dataclass(frozen=True, slots=True, kw_only=True)
class FrictionElement:
    """A friction element between two shafts, or a brake between one and the housing."""

    name: str
    between: tuple[str, str]

    def row(self, place: Mapping[str, int]) -> FloatArray:
        """Return what its slip is of the speeds, shape (shafts,)."""
        return _row(place, {self.between[0]: 1.0, self.between[1]: -1.0})


@dataclass(frozen=True, slots=True, kw_only=True)
class Gear:
    """What is applied in a gear, and its ratio as stated, input over output speed; reverse has number -1."""

    number: int
    elements: tuple[str, ...]
    ratio: float
    gear_pairs: tuple[str, ...] = ()


class Slip(NamedTuple):
    """The slip of an element as the sum of input and output speed, each times a number, while all else holds."""

    by_input: float  # the lever of the element on the input, too: its torque acts there by so much (virtual work)
    by_output: float


class GearChange(NamedTuple):
    """A change of gears from one element to another."""

    lower: int
    upper: int
    coming: str  # going up; going down it lets go
    going: str
    slips: tuple[Slip, Slip]  # of the one that comes and the one that goes

    @property
    def told(self) -> Iterator[tuple[str, tuple[int, int], Slip]]:
        """Yield which elements can be told from which gear to which: those that move the input while they slip."""
        ways = ((self.lower, self.upper), (self.upper, self.lower))
        for element, gears, slip in zip((self.coming, self.going), ways, self.slips, strict=True):
            if abs(slip.by_input) >= LEAST_LEVER:
                yield element, gears, slip


@dataclass(frozen=True, slots=True, kw_only=True)
class Transmission:
    """A transmission, whose gears are checked when it is made.

    Raises
    ------
    CalibrationError
        Naming the first gear whose parts do not exist, do not determine its speeds, or contradict its ratio.
    """

    name: str
    input: str
    output: str
    elements: tuple[FrictionElement, ...]
    gears: tuple[Gear, ...]
    gear_pairs: tuple[GearPair, ...] = ()
    planetary_sets: tuple[PlanetarySet, ...] = ()

    def __post_init__(self) -> None:
        """Check that every gear works, and has the ratio that is stated."""
        for name in (self.input, self.output):
            require(name in self.place, f"no part has the shaft {name!r}")
        for gear in self.gears:
            ratio = self.ratio(gear)
            require(bool(np.isfinite(ratio)), f"gear {gear.number}: its parts leave the output free")
            fits = abs(ratio / gear.ratio - 1.0) <= MOST_RATIO_ERROR
            require(fits, f"gear {gear.number}: its parts make {ratio:.4f}, not {gear.ratio:.4f}")

    @property
    def place(self) -> dict[str, int]:
        """Where each shaft stands among the speeds."""
        parts: tuple[FrictionElement | GearPair, ...] = (*self.elements, *self.gear_pairs)
        names = [name for part in parts for name in part.between]
        names += [
            name for planetary in self.planetary_sets for name in (planetary.sun, planetary.ring, planetary.carrier)
        ]
        return {name: place for place, name in enumerate(dict.fromkeys(name for name in names if name != HOUSING))}

    def ratio(self, gear: Gear) -> float:
        """Return input over output speed in a gear, from its parts."""
        return 1.0 / float(self._speeds(gear)[self.place[self.output]])

    def levers(self, gear: Gear) -> dict[str, float]:
        """Return the torque of each applied element over that of the input, where all of it is in balance."""
        place = self.place
        rows = [*self._fixed(gear.gear_pairs), *(self._element(name, gear).row(place) for name in gear.elements)]
        balance = np.column_stack([*rows, _row(place, {self.output: 1.0})])
        torques = np.linalg.lstsq(balance, _row(place, {self.input: 1.0}))[0]
        first = len(rows) - len(gear.elements)
        return dict(zip(gear.elements, torques[first:].tolist(), strict=False))  # behind them stands the output

    def slips(self, gear: Gear) -> dict[str, float]:
        """Return the slip of each open element over the speed of the input; NaN of one at a shaft that is free."""
        speeds, place = self._speeds(gear), self.place
        return {
            element.name: _of(element.row(place), speeds)
            for element in self.elements
            if element.name not in gear.elements
        }

    def changes(self) -> Iterator[GearChange]:
        """Yield the changes between forward gears in which one element comes and one goes."""
        forward = [gear for gear in self.gears if gear.number > 0]
        for lower in forward:
            for upper in forward:
                coming = set(upper.elements) - set(lower.elements)
                going = set(lower.elements) - set(upper.elements)
                if lower.number < upper.number and len(coming) == len(going) == 1:
                    yield self._change(lower, upper, coming.pop(), going.pop())

    def _change(self, lower: Gear, upper: Gear, coming: str, going: str) -> GearChange:
        place = self.place
        held = [self._element(name, upper).row(place) for name in upper.elements if name in lower.elements]
        pairs = dict.fromkeys((*lower.gear_pairs, *upper.gear_pairs))
        rows = [*self._fixed(pairs), *held, _row(place, {self.input: 1.0}), _row(place, {self.output: 1.0})]
        both = _solved(rows, np.eye(len(rows))[:, -2:], f"change {lower.number}-{upper.number}")
        slips = [
            Slip(*(_of(self._element(name, upper).row(place), speeds) for speeds in both.T)) for name in (coming, going)
        ]
        return GearChange(lower.number, upper.number, coming, going, (slips[0], slips[1]))

    def _speeds(self, gear: Gear) -> FloatArray:
        """Return the speeds of all shafts in a gear, while the input turns with 1."""
        place = self.place
        rows = [*self._fixed(gear.gear_pairs), *(self._element(name, gear).row(place) for name in gear.elements)]
        rows.append(_row(place, {self.input: 1.0}))
        return _solved(rows, np.eye(len(rows))[:, -1], f"gear {gear.number}")

    def _fixed(self, pairs: Iterable[str]) -> list[FloatArray]:
        """Return the rows of planetary sets and of the gear pairs that are engaged."""
        known, place = {pair.name: pair for pair in self.gear_pairs}, self.place
        for name in pairs:
            require(name in known, f"no gear pair {name!r}")
        return [planetary.row(place) for planetary in self.planetary_sets] + [known[name].row(place) for name in pairs]

    def _element(self, name: str, gear: Gear) -> FrictionElement:
        for element in self.elements:
            if element.name == name:
                return element
        raise CalibrationError(f"gear {gear.number}: no element {name!r}")

    @classmethod
    def from_mapping(cls, table: Mapping[str, Any]) -> Self:
        """Build a transmission from the tables of a file; raises CalibrationError, naming the first offending key."""
        description = dict(table)
        version = description.pop("format", None)
        require(version == FORMAT, f"transmission.format must be {FORMAT}, got {version!r}")
        return record_from(cls, description, "transmission.")


def read_transmission(path: Path | str) -> Transmission:
    """Read the table ``[transmission]`` of a file, or of a shipped type that is named.

    Raises
    ------
    CalibrationError
        If the file cannot be read, has no such table, or describes none that works.
    """
    table = calibration_table(Path(path)).get("transmission")
    if not isinstance(table, Mapping):
        raise CalibrationError(f"{path} has no table [transmission]")
    try:
        return Transmission.from_mapping(table)
    except CalibrationError as exc:
        raise CalibrationError(f"{path}: {exc}") from exc


def _of(row: FloatArray, speeds: FloatArray) -> float:
    """Return what a row is of the speeds, of which others may be unknown."""
    return float(row[row != 0.0] @ speeds[row != 0.0])


def _row(place: Mapping[str, int], factors: Mapping[str, float]) -> FloatArray:
    row = np.zeros(len(place))
    for name, factor in factors.items():
        if name != HOUSING:
            require(name in place, f"no part has the shaft {name!r}")
            row[place[name]] += factor
    return row


def _solved(rows: Sequence[FloatArray], right: FloatArray, what: str) -> FloatArray:
    """Return the speeds that the rows determine; those of shafts that they leave free are NaN.

    Raises CalibrationError if the rows contradict each other.
    """
    matrix = np.array(rows)
    speeds = np.linalg.lstsq(matrix, right)[0].astype(np.float64)
    is_solved = np.allclose(matrix @ speeds, right, atol=_ROUNDING)
    require(is_solved, f"{what}: its parts block each other")
    _, values, directions = np.linalg.svd(matrix)
    free = directions[np.count_nonzero(values > _ROUNDING) :]
    speeds[np.abs(free).max(axis=0, initial=0.0) > _ROUNDING] = np.nan
    return speeds
