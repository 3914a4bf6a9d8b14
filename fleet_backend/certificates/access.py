"""What each certificate of a folder may say and hear at its broker: files for Mosquitto and for nats-server.

A vehicle writes under its own name and reads what is for it alone. Mosquitto's `acl_file` grants every subscription, so
a vehicle could join the group of the workers and take its turns; the dynamic security plugin refuses it. Its 2.0 has no
placeholder for a name, so each vehicle has a role of its own.
"""

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Final

from cryptography import x509
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from fleet_backend.errors import CertificateError
from fleet_contract import CLUTCHES, TOPIC_ROOT, Channel

OFFICE: Final = "fleet-"  # what the names of the backend's programs begin with; no vehicle's does
ALARMS: Final = "clutchdiag/alarms/v1/+"
MOSQUITTO_FILE: Final = "dynamic-security.json"
NATS_FILE: Final = "nats-users.conf"


def write_access(folder: Path) -> None:
    """Write both files beside the certificates; raises CertificateError if that fails."""
    try:
        names = sorted(filter(None, map(_client, folder.glob("*.crt"))))
        for name, text in ((MOSQUITTO_FILE, mosquitto_access(names)), (NATS_FILE, nats_users(names))):
            fresh = folder / f".{name}.{os.getpid()}"
            fresh.write_text(text, encoding="utf-8")
            fresh.replace(folder / name)
    except (OSError, ValueError) as exc:
        raise CertificateError(f"cannot read or write {folder}: {exc}") from exc


def mosquitto_access(names: Sequence[str]) -> str:
    """Return the file of the dynamic security plugin (Mosquitto 2.0 and 2.1) for clients of these names."""
    roles = [{"rolename": "office", "acls": _office_rules()}]
    roles += [{"rolename": f"vehicle {name}", "acls": _rules(name)} for name in names if not name.startswith(OFFICE)]
    role_of = {name: "office" if name.startswith(OFFICE) else f"vehicle {name}" for name in names}
    content = {
        "defaultACLAccess": {
            "publishClientSend": False,
            "publishClientReceive": False,
            "subscribe": False,
            "unsubscribe": True,
        },
        "clients": [{"username": name, "roles": [{"rolename": role_of[name]}]} for name in names],
        "groups": [],
        "roles": roles,
    }
    return json.dumps(content, indent=1) + "\n"


def nats_users(names: Sequence[str]) -> str:
    """Return the users of nats-server, to be included in its block `authorization`."""
    users = "".join(_nats_user(name) for name in names)
    return f"users: [\n{users}]\n"


def _rules(name: str) -> list[dict[str, object]]:
    said, heard = _topics(name, is_to_vehicle=False), _topics(name, is_to_vehicle=True)
    return [
        *(_rule("publishClientSend", topic) for topic in said),
        *(_rule(kind, topic) for topic in heard for kind in ("subscribeLiteral", "publishClientReceive")),
    ]


def _office_rules() -> list[dict[str, object]]:
    heard = _topics("+", is_to_vehicle=False)
    shared = [f"$share/+/{topic}" for topic in heard]
    return [
        *(_rule("publishClientSend", topic) for topic in (*_topics("+", is_to_vehicle=True), ALARMS)),
        *(_rule("publishClientReceive", topic) for topic in heard),
        *(_rule("subscribePattern", topic) for topic in (*heard, *shared)),
    ]


def _topics(name: str, *, is_to_vehicle: bool) -> list[str]:
    """Return the topics of one side; a vehicle's are literal: a broker keeps the last message of each name."""
    clutches = ("+",) if name == "+" else CLUTCHES
    return [
        f"{TOPIC_ROOT}/{name}/{label}"
        for channel in Channel
        if channel.is_to_vehicle is is_to_vehicle
        for label in ([f"clutch/{one}" for one in clutches] if channel is Channel.CLUTCH else [channel.label])
    ]


def _rule(kind: str, topic: str) -> dict[str, object]:
    return {"acltype": kind, "topic": topic, "priority": 0, "allow": True}


def _nats_user(name: str) -> str:
    if name.startswith(OFFICE):
        publish = [*_subjects("+", is_to_vehicle=True), "$JS.API.>", "$JS.ACK.>"]
        subscribe, kinds = ["_INBOX.>"], "STANDARD"
    else:
        publish = _subjects(name, is_to_vehicle=False)
        # On the port of NATS itself the last subject would be everybody's messages.
        subscribe, kinds = [*_subjects(name, is_to_vehicle=True), "$MQTT.sub.>"], "MQTT"
    permissions = f"{{publish: {json.dumps(publish)}, subscribe: {json.dumps(subscribe)}}}"
    kept_to = f"allowed_connection_types: [{json.dumps(kinds)}]"
    return f"  {{user: {json.dumps(f'CN={name}')}, {kept_to}, permissions: {permissions}}}\n"


def _subjects(name: str, *, is_to_vehicle: bool) -> list[str]:
    return [topic.replace("/", ".").replace("+", "*") for topic in _topics(name, is_to_vehicle=is_to_vehicle)]


def _client(path: Path) -> str | None:
    """Return whose certificate a file is, None for that of a server or an authority."""
    certificate = x509.load_pem_x509_certificate(path.read_bytes())
    try:
        purposes = certificate.extensions.get_extension_for_class(x509.ExtendedKeyUsage).value
    except x509.ExtensionNotFound:
        return None
    (name,) = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
    return str(name.value) if list(purposes) == [ExtendedKeyUsageOID.CLIENT_AUTH] else None
