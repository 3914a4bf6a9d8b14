"""Provisioned dashboards as Grafana reads them: their queries, with macros and variables filled in as it fills them."""

import json
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Final

from ruamel.yaml import YAML

ROOT: Final = Path(__file__).parents[2]
FOLDER: Final = ROOT / "docs" / "deploy" / "grafana"
PROMETHEUS: Final = ROOT / "docs" / "deploy" / "prometheus"
DASHBOARDS: Final = sorted((FOLDER / "dashboards").glob("*.json"))
_MACRO: Final = re.compile(r"\$__(\w+)\(([^)]*)\)")
_VARIABLE: Final = re.compile(r"\$(\w+)")

Table = dict[str, Any]


@dataclass(frozen=True, slots=True, kw_only=True)
class Query:
    """One question that a dashboard asks."""

    dashboard: str
    asker: str  # title of the panel, name of the annotation or variable, and letter of the target
    source: Table  # type and uid of the datasource
    text: str
    panel: Table | None = None

    def __str__(self) -> str:
        return f"{self.dashboard}: {self.asker}"


def dashboard(path: Path) -> Table:
    """Return what a file says."""
    content: Table = json.loads(path.read_text(encoding="utf-8"))
    return content


def yaml(path: Path) -> Table:
    """Return what a provisioning file says."""
    content: Table = YAML(typ="safe", pure=True).load(path.read_text(encoding="utf-8"))
    return content


def queries() -> Iterator[Query]:
    """Yield every query of every dashboard: of panels, annotations and variables."""
    for path in DASHBOARDS:
        board = dashboard(path)
        for panel in board["panels"]:
            for target in panel["targets"]:
                text = target.get("rawSql") or target["expr"]
                asker = f"{panel['title']} {target['refId']}"
                yield Query(dashboard=path.stem, asker=asker, source=target["datasource"], text=text, panel=panel)
        for note in board["annotations"]["list"]:
            text = note.get("rawQuery") or note["expr"]
            yield Query(dashboard=path.stem, asker=note["name"], source=note["datasource"], text=text)
        for variable in board["templating"]["list"]:
            text = variable["definition"]
            yield Query(dashboard=path.stem, asker=variable["name"], source=variable["datasource"], text=text)


def of_source(uid: str) -> list[Query]:
    """Return the queries that go to a datasource."""
    return [query for query in queries() if query.source["uid"] == uid]


def sql(text: str, vehicles: Sequence[str], since: datetime, until: datetime) -> str:
    """Return SQL as Grafana sends it to PostgreSQL; a macro or variable that this knows nothing of is an error."""
    moments = [moment.astimezone(UTC).isoformat().replace("+00:00", "Z") for moment in (since, until)]

    def macro(found: re.Match[str]) -> str:
        if found[1] != "timeFilter":
            raise ValueError(f"unknown macro {found[0]}")
        return f"{found[2].strip()} BETWEEN '{moments[0]}' AND '{moments[1]}'"

    quoted = ",".join("'{}'".format(vehicle.replace("'", "''")) for vehicle in vehicles)
    return _filled(_MACRO.sub(macro, text), {"vehicle": quoted})


def promql(text: str, vehicles: Sequence[str], shown: str) -> str:
    """Return PromQL as Grafana sends it, of a time range ``shown`` such as ``2h``."""
    values = {"vehicle": f"({'|'.join(map(re.escape, vehicles))})", "__range": shown, "__rate_interval": "5m"}
    return _filled(text, values)


def _filled(text: str, values: dict[str, str]) -> str:
    def value(found: re.Match[str]) -> str:
        if found[1] not in values:
            raise ValueError(f"unknown variable {found[0]}")
        return values[found[1]]

    return _VARIABLE.sub(value, text)
