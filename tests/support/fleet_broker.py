"""A Mosquitto under the configuration of docs/deploy, with certificates of its own."""

import re
from pathlib import Path

from fleet_backend.certificates.access import MOSQUITTO_FILE, write_access
from fleet_backend.certificates.authority import Authority
from tests.plugins.broker import Mosquitto

DEPLOY = Path(__file__).parents[2] / "docs" / "deploy"
_OURS = re.compile(r"(#|listener|allow_anonymous|persistence|max_(inflight|queued)_messages)")
_PLUGIN = "mosquitto_dynamic_security.so"


def fleet_broker(folder: Path, authority: Authority, *more: str) -> Mosquitto:
    """Return a broker, off until started, for all that have certificates by now."""
    folder.mkdir()
    write_access(authority.folder)
    access = folder / MOSQUITTO_FILE
    (authority.folder / MOSQUITTO_FILE).replace(access)
    access.chmod(0o600)
    (plugin,) = sorted(path for place in ("/usr/lib", "/usr/local/lib") for path in Path(place).rglob(_PLUGIN))[:1]
    text = (
        (DEPLOY / "mosquitto.conf")
        .read_text(encoding="utf-8")
        .replace(f"/usr/lib/x86_64-linux-gnu/{_PLUGIN}", str(plugin))
    )
    text = text.replace(f"/etc/clutchdiag/{MOSQUITTO_FILE}", str(access)).replace(
        "/etc/clutchdiag", str(authority.folder)
    )
    lines = (*(line for line in text.splitlines() if line and not _OURS.match(line)), *more)
    return Mosquitto(folder, lines, is_durable=False)  # it saves as often as ours; at each change: hardly anything else
