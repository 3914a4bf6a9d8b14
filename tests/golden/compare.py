"""What each audience gets of a stored set of recordings: a change of the house changes none of it.

JSON lines, MQTT messages, the store's tables and the report of each recording come from one run of the service over a
real broker; the fleet's pages are made of the messages of all. The moment at which something was written is no part of
it. ``python -m tests.golden.compare`` prints what differs, ``--write`` takes today's for right: for a change that is
meant to change them, with the figures before and after beside it.
"""

import argparse
import json
import lzma
import re
import sqlite3
import sys
import tempfile
import urllib.request
from collections.abc import Iterable, Iterator
from contextlib import chdir, closing, contextmanager
from pathlib import Path

from fleet_backend.database import open_database
from fleet_backend.intake import batch_of, receive
from fleet_backend.migrate import migrate
from fleet_backend.writer import Writer
from fleet_contract import JsonObject, shift_message
from fleet_link import Message
from tests.golden.differences import arithmetic, differences
from tests.plugins.broker import Mosquitto
from tests.support.fleet import NOW
from tests.support.fleet_page import served
from tests.support.in_process import ended
from tests.support.subscriber import Subscriber

FOLDER = Path(__file__).parent
RECORDINGS, FACES = FOLDER / "recordings", FOLDER / "faces"
ARITHMETIC = FACES / "arithmetic.txt"
DATA = FOLDER.parent / "data"
OPTIONS = {
    "foreign": ["--dbc", str(DATA / "foreign.dbc"), "--profile", str(DATA / "foreign.toml")],
    "j1939": ["--profile", "j1939"],
}
NAMES = sorted(path.name.partition(".")[0] for path in RECORDINGS.glob("*.log.xz"))
CALIBRATED = "routine"
PAGES = {"fleet": "/", "vehicle": "/vehicles/case2", "maintenance": "/maintenance"}
TABLES = {"result": "position", "state": "vehicle", "fill": "vehicle, filled_at"}  # and the order of their rows
_WRITTEN_AT = ("connected_at", "disconnected_at")
_MOMENT = re.compile(r"20(?!26-01-01)\d\d-\d\d-\d\d([T ]\d\d:\d\d(:\d\d(\.\d+)?)?(Z|\+00:00)?)?|read at \d\d:\d\d:\d\d")

Faces = dict[str, str]  # what is seen, by its kind


def recording(name: str, folder: Path, broker: Mosquitto) -> Faces:
    """Return what a run of the service over a recording shows, files in an empty folder, a broker that runs."""
    store, report, options = folder / f"{name}.sqlite", folder / f"{name}.html", OPTIONS.get(name, [])
    with Subscriber(broker.port) as subscriber:
        delivered = ["--store", str(store), "--vehicle", name, "--broker", broker.url]
        lines = _service("analyze", f"{name}.log.xz", *options, *delivered, "--json")
        shift_count = lines.count('{"schema":"clutchdiag/shift/')
        # A connection that was lost says "offline" too, before the results come by the next one.
        subscriber.wait(
            lambda heard: (
                len(shifts := heard.payloads("/shift")) >= shift_count
                and all(
                    [state["seq"] for state in heard.payloads(f"/clutch/{clutch}")[-1:]] == [seq]
                    for clutch, seq in {one["verdict"]["clutch"]: one["seq"] for one in shifts}.items()
                )
                and [status["status"] for status in heard.payloads("/status")[-1:]] == ["offline"]
            )
        )
        last = {topic: data for topic, data in subscriber.messages() if not topic.endswith("/shift")}
        shifts: list[JsonObject] = [
            {"topic": topic, "data": data} for topic, data in subscriber.messages() if topic not in last
        ]
    _service("report", f"{name}.log.xz", *options, "--vehicle", name, "-o", str(report))
    states: list[JsonObject] = [{"topic": topic, "data": _undated(data)} for topic, data in last.items()]
    return {
        "results": lines,
        "messages": _json_lines(shifts + states),
        "store": _json_lines(_rows(store)),
        "report": _MOMENT.sub("MOMENT", report.read_text(encoding="utf-8")),
    }


def calibration(folder: Path) -> Faces:
    """Return what the service says of a calibration, and the file that it writes."""
    path = folder / "found.toml"
    said = _service("calibrate", f"{CALIBRATED}.log.xz", "--vehicle", "golden", "--output", str(path), "--json")
    return {"calibrate": said, "calibration": path.read_text(encoding="utf-8")}


def pages(folder: Path) -> Faces:
    """Return the fleet's pages of vehicles that sent the stored messages."""
    database = f"sqlite:///{folder / 'fleet.sqlite'}"
    engine = open_database(database)
    migrate(engine)
    for name in NAMES:
        stored = map(json.loads, stored_faces(name)["messages"].splitlines())
        shifts = [shift_message(message["data"]) for message in stored if message["topic"].endswith("/shift")]
        received = [Message(topic=shift.topic, payload=shift.payload, packet_id=1) for shift in shifts]
        Writer(engine).store(batch_of([receive(message, NOW) for message in received]))
    engine.dispose()
    with served(database, now=NOW) as address:  # the calendar begins with a day
        return {name: _MOMENT.sub("MOMENT", _text(f"{address}{path}")) for name, path in PAGES.items()}


def stored_faces(name: str) -> Faces:
    """Return what was seen when it was taken for right."""
    faces: Faces = json.loads(lzma.decompress((FACES / f"{name}.json.xz").read_bytes()))
    return faces


def is_exact() -> bool:
    """Return whether this machine must come to the same last digits."""
    return ARITHMETIC.read_text(encoding="utf-8").strip() == arithmetic()


def _text(address: str) -> str:
    with urllib.request.urlopen(address) as answer:  # noqa: S310 - a server of ours
        return str(answer.read(), encoding="utf-8")


def _rows(store: Path) -> Iterator[JsonObject]:
    with closing(sqlite3.connect(store)) as connection:
        connection.row_factory = sqlite3.Row
        for table, order in TABLES.items():
            for row in connection.execute(f"SELECT * FROM {table} ORDER BY {order}"):  # noqa: S608 - names of ours
                yield {"table": table, **{key: _value(row[key]) for key in row.keys()}}  # noqa: SIM118 - no dict


def _value(value: object) -> object:
    return json.loads(value) if isinstance(value, str) and value.startswith(("{", "[")) else value


def _undated(data: JsonObject) -> JsonObject:
    return {key: value for key, value in data.items() if key not in _WRITTEN_AT}


def _json_lines(records: Iterable[JsonObject]) -> str:
    return "".join(json.dumps(record) + "\n" for record in records)


def _service(*words: str) -> str:
    with chdir(RECORDINGS):
        found = ended(*words)
    if found.status:
        raise RuntimeError(found.err)
    return found.out


@contextmanager
def _running_broker(folder: Path) -> Iterator[Mosquitto]:
    broker = Mosquitto(folder)
    broker.start()
    try:
        yield broker
    finally:
        broker.stop()


def _faces(name: str) -> Faces:
    with tempfile.TemporaryDirectory() as folder:
        match name:
            case "pages":
                return pages(Path(folder))
            case "calibration":
                return calibration(Path(folder))
        with _running_broker(Path(folder)) as broker:
            return recording(name, Path(folder), broker)


def main() -> int:
    """Compare or write all; return 1 if anything differs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true")
    is_writing, count = parser.parse_args().write, 0
    if is_writing:
        FACES.mkdir(exist_ok=True)
        ARITHMETIC.write_text(arithmetic() + "\n", encoding="utf-8")
    for name in (*NAMES, "calibration", "pages"):  # pages are made of the messages of all before
        faces = _faces(name)
        if is_writing:
            (FACES / f"{name}.json.xz").write_bytes(lzma.compress(json.dumps(faces).encode()))
        for kind, before in stored_faces(name).items():
            found = list(differences(before, faces[kind], is_exact=False))
            is_equal = faces[kind] == before
            print(f"{name}, {kind}: {'byte for byte' if is_equal else f'{len(found)} differ'}")
            print(*found[:5], sep="\n", end="\n" if found else "")
            count += len(found)
    return 1 if count else 0


if __name__ == "__main__":
    sys.exit(main())
