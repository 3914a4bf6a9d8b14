"""A Mosquitto under the configuration of docs/deploy, with certificates of its own."""

import re
import shutil
from pathlib import Path

from tests.plugins.broker import Mosquitto
from tests.support.certificates import play

DEPLOY = Path(__file__).parents[2] / "docs" / "deploy"
_OURS = re.compile(r"(#|listener|allow_anonymous|persistence|max_(inflight|queued)_messages)")
_PLUGIN = "mosquitto_dynamic_security.so"


def write_access(folder: Path) -> None:
    """Write the brokers' files into a folder, with an entry for each vehicle that has a certificate there."""
    for name in ("dynamic-security.json", "nats.conf"):
        shutil.copy(DEPLOY / name, folder / name)
        (folder / name).chmod(0o600)
    for path in sorted(folder.glob("*.crt")):
        if path.stem not in {"ca", "broker", "fleet-backend"}:
            play(folder, "s/VEHICLE/", path.stem)


def fleet_broker(folder: Path, certificates: Path, *more: str) -> Mosquitto:
    """Return a broker, off until started, for all that have certificates by now."""
    folder.mkdir()
    write_access(certificates)
    (plugin,) = sorted(path for place in ("/usr/lib", "/usr/local/lib") for path in Path(place).rglob(_PLUGIN))[:1]
    text = (DEPLOY / "mosquitto.conf").read_text(encoding="utf-8")
    text = text.replace(f"/usr/lib/x86_64-linux-gnu/{_PLUGIN}", str(plugin))
    text = text.replace("/etc/clutchdiag", str(certificates))
    lines = (*(line for line in text.splitlines() if line and not _OURS.match(line)), *more)
    return Mosquitto(folder, lines, is_durable=False)  # it saves as often as ours; at each change: hardly anything else
