"""People read bar, degrees Celsius, kilometres and rpm, with four digits at most; programs read SI."""

import contextlib
import html
import re
from pathlib import Path

import pytest

from clutch_model.units import for_people
from clutch_results.records import shift_record
from clutchdiag_io.people import SLOPE_UNIT, digits
from diag_service.commands.store import shift_lines
from tests.golden.compare import RECORDINGS
from tests.integration.test_plus_minus import FACES
from tests.support.builders import shift_result
from tests.support.in_process import ended

TOO_MANY = re.compile(r"\d\.\d{7}|e[+-]\d")
SI = re.compile(r"\w*_(?:pa|k|m_s\d?|rad_s\d?|s_rad|rad|nm|j)\b|\S*\brad\b\S*|\[(?:K|Pa|J|m|m/s)\]")
DECIMAL = re.compile(r"(?<![\d.:T])\d+\.\d+(?![\d.]|-\d)")
VERSION = re.compile(r"clutchdiag \d\S+|torque-impulse-\d+|\d+\+[0-9a-f]+|[0-9a-f]{64}|20\d\d-\S+(?: [\d:.]+)?")


def complaints(text: str) -> set[str]:
    """Return what of a text that people read is in SI or has more than four digits."""
    text = VERSION.sub("", text)
    return (
        set(SI.findall(text))
        | {one for one in DECIMAL.findall(text) if len(one.replace(".", "").lstrip("0")) > 4}
        | set(re.findall(r"100\.0 %", text))
    )


def read_by_people(page: str) -> str:
    """Return the words of a page: neither markup nor pictures nor what is there for programs."""
    page = re.sub(r"<(style|script|svg)\b.*?</\1>", "", page, flags=re.DOTALL)
    return html.unescape(re.sub(r"<[^>]+>", " ", page))


@pytest.fixture(name="store", scope="module")
def _store(tmp_path_factory: pytest.TempPathFactory) -> Path:
    store = tmp_path_factory.mktemp("store") / "car1.sqlite"
    with contextlib.chdir(RECORDINGS):
        assert ended("analyze", "case2.log.xz", "--vehicle", "car1", "--store", store).status == 0
    return store


@pytest.mark.parametrize("face", FACES)
def test_faces_of_results_that_were_made_up(face: str) -> None:
    assert complaints(read_by_people(FACES[face]())) == set()


@pytest.mark.parametrize("words", [("analyze", "--verbose"), ("inspect",)])
def test_what_a_terminal_tells_of_a_log(words: tuple[str, ...]) -> None:
    with contextlib.chdir(RECORDINGS):
        found = ended(words[0], "case2.log.xz", *words[1:])
    assert found.status == 0, found.err
    assert complaints(found.out) == set()


@pytest.mark.parametrize("words", [("history",), ("show",)])
def test_what_a_terminal_tells_of_a_store(store: Path, words: tuple[str, ...]) -> None:
    found = ended(words[0], store, *(("3",) if words[0] == "show" else ()))
    assert found.status == 0, found.err
    assert complaints(found.out) == set()


def test_the_report_of_a_log(tmp_path: Path) -> None:
    with contextlib.chdir(RECORDINGS):
        assert ended("report", "case2.log.xz", "-o", tmp_path / "page.html", "--full").status == 0
    text = read_by_people((tmp_path / "page.html").read_text("utf-8"))
    assert f"slope {SLOPE_UNIT}" in text
    assert complaints(text) == set()


def test_a_touch_point_is_given_in_bar() -> None:
    with contextlib.chdir(RECORDINGS):
        found = ended("predict", "case2.log.xz", "--touch", "1.25")
    assert found.status == 0, found.err
    assert found.out.splitlines()[-1] == "touch point: 1.25 bar"
    assert complaints(found.out) == set()
    assert "touch point of the clutches in bar" in " ".join(ended("predict", "--help").out.split())


@pytest.mark.parametrize(
    ("value", "text"),
    [(0.1209111254, "0.1209"), (61001.2615, "61001"), (2.48, "2.48"), (88.98, "88.98"), (0.0, "0"), (-0.5, "-0.5"),
     (248000.0, "248000"), (1.0, "1"), (1e-9, "0"), (-1e-9, "0"), (0.000427512, "0.000428")],
)  # fmt: skip
def test_a_number_has_the_digits_that_tell_something(value: float, text: str) -> None:
    assert digits(value) == text


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [("touch_error_pa", 2.48e5, "touch_error 2.48 bar"), ("peak1_k", 362.13, "peak1 88.98 °C"),
     ("odometer_m", 61001261.5, "odometer 61001 km"), ("peak_slip_rad_s", 46.7233, "peak_slip 446.2 rpm"),
     ("temperature_rise_k", 12.0, "temperature_rise 12 K"), ("slope_s_rad", -0.00141, "slope -0.1477 per 1000 rpm"),
     ("jerk_m_s3", 24.25, "jerk 24.25 m/s³"), ("lock_rate_rad_s2", 89.03, "lock_rate 850.2 rpm/s"),
     ("mu_s", 0.13, "mu_s 0.13"),
     ("slip_angle_rad", 62.83, "slip_angle 10 turns")],
)  # fmt: skip
def test_a_quantity_has_the_unit_of_a_workshop(name: str, value: float, told: str) -> None:
    label, shown, unit = for_people(name, value)
    assert f"{label} {digits(shown)} {unit}".strip() == told


def test_what_is_stored_of_a_shift_is_shown_for_people_and_kept_in_si() -> None:
    record = shift_record(shift_result(1))
    lines = [line.plain.strip() for line in shift_lines(record)]
    assert {"odometer  1.234 km", "sump_temperature  80 °C", "slip_energy  8.4 kJ"} <= set(lines)
    assert not [line for line in lines if TOO_MANY.search(line)]
    assert record["sump_temperature_k"] == 353.15
