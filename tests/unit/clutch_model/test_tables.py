"""Tables of files become records: what does not fit is named with its key, its cause and its value."""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import NamedTuple

import pytest

from clutch_model.errors import CalibrationError
from clutch_model.tables import record_from, require


class Colour(StrEnum):
    RED = "red"
    BLUE = "blue"


class Spring(NamedTuple):
    rate_n_m: float
    steps: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Wheel:
    radius_m: float

    def __post_init__(self) -> None:
        require(self.radius_m > 0.0, f"radius_m must be > 0, got {self.radius_m}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Car:
    mass_kg: float
    name: str = "car"
    doors: int | None = None
    is_open: bool = False
    colour: Colour = Colour.RED
    ratios: tuple[float, float] = (1.0, 2.0)
    spare: Wheel | None = None
    wheels: tuple[Wheel, ...] = ()
    spring: Spring = field(default_factory=lambda: Spring(1.0))


WHOLE = {
    "mass_kg": 1500,
    "name": "a",
    "doors": 4,
    "is_open": True,
    "colour": "blue",
    "ratios": [1, 2.5],
    "spare": {"radius_m": 0.2},
    "wheels": [{"radius_m": 0.3}, {"radius_m": 0.4}],
    "spring": {"rate_n_m": 7, "steps": [1]},
}


def test_a_table_becomes_a_record_with_records_in_it() -> None:
    car = record_from(Car, WHOLE)
    assert car == Car(
        mass_kg=1500,
        name="a",
        doors=4,
        is_open=True,
        colour=Colour.BLUE,
        ratios=(1.0, 2.5),
        spare=Wheel(radius_m=0.2),
        wheels=(Wheel(radius_m=0.3), Wheel(radius_m=0.4)),
        spring=Spring(7.0, (1.0,)),
    )
    assert record_from(Car, {"mass_kg": 1.5}) == Car(mass_kg=1.5)
    assert record_from(Car, {"mass_kg": 1.5, "spare": Wheel(radius_m=1.0)}).spare == Wheel(radius_m=1.0)
    assert record_from(Car, {}, mass_kg=2.0) == Car(mass_kg=2.0)


def test_whole_numbers_stay_whole_but_where_compiled_code_takes_them() -> None:
    car = record_from(Car, WHOLE)
    assert type(car.mass_kg) is int  # the fingerprint of a calibration tells 1 from 1.0
    assert [type(one) for one in (car.spring.rate_n_m, *car.ratios, *car.spring.steps)] == [float] * 4


@pytest.mark.parametrize(
    ("change", "complaint"),
    [
        ({"mass": 1.0}, r"^car\.mass is unknown; known: colour, doors, "),
        ({"mass_kg": "1"}, r"^car\.mass_kg must be a number, got '1'$"),
        ({"mass_kg": True}, r"car\.mass_kg must be a number, got True"),
        ({"doors": 4.0}, r"car\.doors must be a whole number, got 4\.0"),
        ({"doors": True}, r"car\.doors must be a whole number"),
        ({"name": 3}, r"car\.name must be a string, got 3"),
        ({"is_open": 1}, r"car\.is_open must be true or false, got 1"),
        ({"colour": "green"}, r"car\.colour must be one of red, blue, got 'green'"),
        ({"colour": []}, r"car\.colour must be one of red, blue"),
        ({"ratios": [1.0]}, r"car\.ratios must be a list of 2 numbers, got \[1\.0\]"),
        ({"ratios": [1.0, "2"]}, r"car\.ratios must be a list of 2 numbers"),
        ({"ratios": "12"}, r"car\.ratios must be a list of 2 numbers"),
        ({"spare": 3}, r"car\.spare must be a table, got 3"),
        ({"spare": {}}, r"car\.spare\.radius_m is missing"),
        ({"spare": {"radius_m": -1}}, r"car\.spare\.radius_m must be > 0, got -1"),
        ({"wheels": {"radius_m": 0.3}}, r"car\.wheels must be an array of tables"),
        ({"wheels": [{"radius_m": 0.3}, {"colour": 1}]}, r"car\.wheels 2: colour is unknown"),
        ({"spring": {}}, r"car\.spring\.rate_n_m is missing"),
        ({"spring": {"rate_n_m": 1.0, "steps": 3}}, r"car\.spring\.steps must be a list of numbers"),
    ],
)
def test_what_does_not_fit_is_named(change: dict[str, object], complaint: str) -> None:
    with pytest.raises(CalibrationError, match=complaint):
        record_from(Car, WHOLE | change, "car.")
