"""What the commands that ask make of a controller that answers wrongly: each service, each way."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from tests.support.in_process import ended
from tests.support.service import Ended
from tests.support.uds.wrong_ecu import WAYS, Fault, frames_of, right_answer, wrong_ecu

DESCRIPTION: Final = """
name = "foreign"
[[data]]
number = 0x0102
name = "vehicle speed"
fields = [{ name = "speed", kind = "unsigned", size_bytes = 2, unit = "km/h", resolution = 0.01 }]
[[extended]]
number = 0x01
name = "counter"
fields = [{ name = "times", kind = "unsigned", size_bytes = 1 }]
[[routine]]
number = 0x0301
name = "learn"
results = [{ name = "state", kind = "unsigned", size_bytes = 1 }]
"""
_ROUTINE: Final = ("routine", "0301")

# How a request begins whose answer is wrong, by the name of what is asked, and the command that asks it.
QUESTIONS: Final[Mapping[str, tuple[str, tuple[str, ...]]]] = {
    "10 session": ("1003", ("did", "0102", "--session", "03")),
    "14 clear": ("14", ("dtc", "--brief", "--clear")),
    "19 01 count": ("1901", ("scan", "--first", "7E1", "--last", "7E1", "--wait", "0.1")),
    "19 02 codes": ("1902", ("dtc",)),
    "19 04 snapshots": ("1904", ("dtc",)),
    "19 06 extended data": ("1906", ("dtc",)),
    "22 data": ("220102", ("did", "0102")),
    "27 seed": ("2701", (*_ROUTINE, "start", "--unlock", "1=01020304")),
    "27 key": ("2702", (*_ROUTINE, "start", "--unlock", "1=01020304")),
    "31 start": ("3101", (*_ROUTINE, "start")),
    "31 results": ("3103", (*_ROUTINE, "results")),
}
HARMLESS: Final = {  # valid answers: the truth said more than once, and other values in bytes that repeat nothing
    *((name, "twice") for name in QUESTIONS),
    *((name, "other identifier") for name in ("10 session", "19 01 count", "19 02 codes", "27 seed")),
    ("10 session", "head alone"),  # the edition of 2006
}
DETAILS: Final = {"19 04 snapshots": "snapshots", "19 06 extended data": "extended_data"}
UNREAD: Final = {("31 start", way) for way in ("a byte short", "a byte long")}  # valid: maker's own bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class Told:
    """What a command told."""

    name: str
    way: str
    status: int
    words: str  # the line that says what is wrong
    is_true: bool


def _words(command: tuple[str, ...], channel: str, folder: Path) -> list[str | Path]:
    description = folder / "foreign.toml"
    description.write_text(DESCRIPTION, encoding="utf-8")
    known: tuple[str | Path, ...] = () if command[0] == "scan" else ("--description", description)
    quick = ("--listen", "0", "--timeout", "0.15", "--active", "--json")
    return [*command, "-i", "virtual", "-c", channel, *quick, *known]


def _claims(run: Ended) -> object:
    """Return what was stated of the controller, without what counts questions; None: nothing was."""
    if not run.out:
        return None
    (record,) = run.records
    if "data" in record:
        return [one["values"] for one in record["data"]]
    if "controllers" in record:
        return [
            (one["trouble_codes"], {s["number"]: s["remark"] for s in one["services"]}) for one in record["controllers"]
        ]
    return {name: record[name] for name in ("codes", "cleared", "routine") if name in record}


@cache
def _truth(name: str) -> Any:  # noqa: ANN401 - JSON
    """Return what is stated of a controller that answers rightly."""
    channel = f"right {name}"
    with TemporaryDirectory() as folder, wrong_ecu(channel):
        return _claims(ended(*_words(QUESTIONS[name][1], channel, Path(folder))))


def told(name: str, way: str, folder: Path) -> Told:
    """Ask a controller that answers wrongly in this way, and return what was told beside what is true."""
    begins, command = QUESTIONS[name]
    channel = f"wrong {name} {way}"
    with wrong_ecu(channel, Fault(request=begins, way=WAYS[way])):
        run = ended(*_words(command, channel, folder))
    claims = _claims(run)
    is_same = WAYS[way](bytes.fromhex(begins), right_answer(bytes.fromhex(begins))) == frames_of(
        right_answer(bytes.fromhex(begins))
    )
    return Told(
        name=name,
        way=way,
        status=run.status,
        words=run.err.strip() if run.status else str(claims),
        is_true=_is_true(run, claims, _truth(name), (name, way), is_valid=is_same or (name, way) in HARMLESS),
    )


def _is_true(run: Ended, claims: Any, truth: Any, case: tuple[str, str], *, is_valid: bool) -> bool:  # noqa: ANN401 - JSON
    if is_valid:
        return run.status == 0 and claims == truth
    if case in UNREAD:
        return run.status == 0 and claims["routine"]["values"].keys() <= {"more bytes"}
    if case[0] == "19 01 count":  # a scan goes on; it must say that this service does not answer as it should
        ((count, remarks),) = claims
        return run.status == 0 and count is None and bool(remarks["19"])
    if (left_out := DETAILS.get(case[0])) is not None:  # the codes are told all the same
        rest = {**truth, "codes": [{**one, left_out: []} for one in truth["codes"]]}
        return run.status == 3 and claims == rest and run.err.count("\n") == 1
    is_nothing = claims is None or claims == [None]
    return run.status == 3 and is_nothing and "Traceback" not in run.err and run.err.count("\n") == 1
