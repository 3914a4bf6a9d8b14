"""The shipped dashboards, data sources and alert rules fit each other, docker-compose.yml, metrics and their page."""

import re
from pathlib import Path

import pytest

from tests.support import grafana
from tests.support.grafana import DASHBOARDS, FOLDER, ROOT, Query
from tests.support.image.compose import read_compose
from tests.support.prometheus import RULES, Samples, recorded
from tests.tools import metrics_page

SOURCES = {one["uid"]: one for one in grafana.yaml(FOLDER / "provisioning/datasources/clutchdiag.yml")["datasources"]}
PROVIDER = grafana.yaml(FOLDER / "provisioning/dashboards/clutchdiag.yml")["providers"][0]
COMPOSE = read_compose(ROOT / "docker-compose.yml")["services"]
KINDS = {"postgres": "grafana-postgresql-datasource", "prometheus": "prometheus"}
QUERIES = list(grafana.queries())
METRIC = re.compile(r"\bclutchdiag_\w+")
OFTEN_NONE = {  # where nothing went wrong, or too little was seen
    "clutchdiag_bus_errors_total",
    "clutchdiag_cause_probability",
    "clutchdiag_shift_reasons_total",
    *("clutchdiag_clutch_launches_total", "clutchdiag_clutch_life_ratio_total"),  # this and the next without pressures
    *("clutchdiag_clutch_peak_temperature_kelvin", "clutchdiag_clutch_slip_energy_joules"),
}

OF_THE_FLEET = tuple(f"clutchdiag_{name}_" for name in ("ingest", "fleet", "watch"))  # test_fleet_metrics.py


@pytest.fixture(name="last", scope="module")
def _last() -> Samples:
    """Return the last scrape of the recording."""
    return recorded()[-1]


def mounts(service: str) -> dict[str, Path]:
    """Return the files of ours that a service of docker-compose.yml sees, by where it sees them."""
    volumes = [volume.split(":") for volume in COMPOSE[service]["volumes"]]
    return {target: ROOT / source for source, target, *_ in volumes if source.startswith("./")}


@pytest.mark.parametrize("path", DASHBOARDS, ids=lambda path: path.stem)
def test_a_dashboard_is_whole(path: Path) -> None:
    board = grafana.dashboard(path)
    assert re.fullmatch(r"clutchdiag-[a-z]+", board["uid"])
    assert board["title"]
    assert len({panel["id"] for panel in board["panels"]}) == len(board["panels"]) >= 8
    for panel in board["panels"]:
        letters = [target["refId"] for target in panel["targets"]]
        assert letters == list("ABCDEF"[: len(letters)])
        assert panel["title"]
        assert panel["description"].endswith(".")
        assert panel["fieldConfig"]["defaults"]["unit"]


@pytest.mark.parametrize("query", QUERIES, ids=str)
def test_a_query_goes_to_a_source_that_is_provisioned(query: Query) -> None:
    assert KINDS[SOURCES[query.source["uid"]]["type"]] == query.source["type"]
    if query.panel is not None:
        assert query.panel["datasource"] == query.source


def test_docker_compose_mounts_what_is_provisioned() -> None:
    assert mounts("grafana")[PROVIDER["options"]["path"]] == FOLDER / "dashboards"
    assert mounts("grafana")["/etc/grafana/provisioning"] == FOLDER / "provisioning"
    home = Path(COMPOSE["grafana"]["environment"]["GF_DASHBOARDS_DEFAULT_HOME_DASHBOARD_PATH"])
    assert (mounts("grafana")[str(home.parent)] / home.name).is_file()
    assert mounts("prometheus")["/etc/prometheus"] == RULES.parent
    assert mounts("database")["/docker-entrypoint-initdb.d/reader.sql"] == FOLDER / "reader.sql"


def test_the_sources_are_the_services_of_docker_compose() -> None:
    fleet, prometheus = SOURCES["fleet"], SOURCES["prometheus"]
    environment = COMPOSE["ingest"]["environment"]["CLUTCHDIAG_DATABASE"]
    assert environment.endswith(f"@{fleet['url']}/{fleet['jsonData']['database']}")
    assert f"--web.listen-address={prometheus['url'].removeprefix('http://')}" in COMPOSE["prometheus"]["command"]
    config = grafana.yaml(RULES.parent / "prometheus.yml")
    asked = [target for job in config["scrape_configs"] for target in job["static_configs"][0]["targets"]]
    told = [COMPOSE[name]["command"] for name in ("service", "ingest", "ingest-2", "page")]
    assert asked == [command[command.index("--metrics") + 1] for command in told]
    assert config["rule_files"] == sorted(path.name for path in RULES.parent.glob("*.rules.yml"))
    for name in ("prometheus", "grafana"):
        assert COMPOSE[name]["profiles"] == ["dashboards"]


def test_every_metric_that_is_asked_for_is_served(last: Samples) -> None:
    served = {name for name, _ in last}
    text = "\n".join((RULES.read_text(encoding="utf-8"), *(query.text for query in QUERIES)))
    asked = set(METRIC.findall(text))
    assert len(asked) > 10
    assert asked - served == set()


def test_the_page_lists_every_metric(last: Samples) -> None:
    listed = set(re.findall(r"^\| `(clutchdiag_\w+)`", metrics_page.page(), re.MULTILINE))
    listed = {name for name in listed if not name.startswith(OF_THE_FLEET)}
    assert listed == {name for name, _ in last} | OFTEN_NONE
