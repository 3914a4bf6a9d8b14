"""What Prometheus makes of recorded scrapes: promtool evaluates rules and expressions on them."""

import json
import lzma
import re
import shutil
import subprocess
from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from prometheus_client.openmetrics.parser import text_string_to_metric_families

from tests.support.grafana import PROMETHEUS
from tests.support.patience import HANG_S

RECORDING: Final = Path(__file__).parents[1] / "data" / "ageing-metrics.txt.xz"
RULES: Final = PROMETHEUS / "clutchdiag.rules.yml"
MISSING: Final = "_"  # no sample at that time
STALE: Final = "stale"  # the series ends: its target is gone
_END: Final = "# EOF\n"

Labels = frozenset[tuple[str, str]]
Key = tuple[str, Labels]
Series = dict[Key, list[str]]
Samples = Mapping[Key, float]


def recorded() -> list[Samples]:
    """Return the scrapes of the stored recording, each sample by name and labels."""
    text = lzma.decompress(RECORDING.read_bytes()).decode()
    return [parsed(part + _END) for part in text.split(_END) if part]


def parsed(text: str) -> Samples:
    """Return the samples of one scrape in the format of OpenMetrics."""
    return {
        (sample.name, frozenset(sample.labels.items())): float(sample.value)
        for family in text_string_to_metric_families(text)  # type: ignore[no-untyped-call]
        for sample in family.samples
    }


def series(scrapes: Sequence[Samples], **labels: str) -> Series:
    """Return scrapes as series with the labels of their target; a vehicle is renamed where one is named."""
    found: Series = defaultdict(lambda: [MISSING] * len(scrapes))
    for row, samples in enumerate(scrapes):
        for (name, own), value in samples.items():
            kept = dict(own)
            target = {label: text for label, text in labels.items() if label != "vehicle" or label in kept}
            found[name, frozenset({**kept, **target}.items())][row] = repr(value)
    return dict(found)


def group_of(name: str, of: Series, **tests: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """Return tests on series whose samples are a minute apart."""
    inputs = [{"series": shown(key), "values": " ".join(values)} for key, values in of.items()]
    return {"name": name, "interval": "1m", "input_series": inputs, **tests}


def shown(key: Key) -> str:
    """Return name and labels as PromQL writes them."""
    name, labels = key
    return f"{name}{{{', '.join(f'{label}={json.dumps(text)}' for label, text in sorted(labels))}}}"


def answers(expression: str, minute: int, *, vehicles: int) -> dict[str, Any]:
    """Return the test that an expression has answers for at least so many vehicles."""
    return {
        "expr": f"count(count by (vehicle) ({expression})) >= bool {vehicles}",
        "eval_time": f"{minute}m",
        "exp_samples": [{"labels": "{}", "value": 1}],
    }


def promtool(*words: str | Path, given: str | None = None) -> str:
    """Return what promtool says; it must find nothing to complain of."""
    program = shutil.which("promtool")
    assert program is not None, "promtool is missing: the Debian package prometheus has it (make setup-system)"
    done = subprocess.run(
        [program, *map(str, words)], input=given, capture_output=True, text=True, check=False, timeout=HANG_S
    )
    said = done.stdout + done.stderr
    assert done.returncode == 0, said
    return said


def check_rules(folder: Path, groups: Iterable[Mapping[str, Any]], rules: Path = RULES) -> None:
    """Let promtool evaluate the shipped rules on the series of test groups, and hold it against what they expect."""
    path = folder / "tests.yml"  # JSON is YAML
    content = {"rule_files": [str(rules)], "evaluation_interval": "1m", "tests": list(groups)}
    path.write_text(json.dumps(content), encoding="utf-8")
    said = promtool("test", "rules", path)
    assert re.search("SUCCESS", said), said
