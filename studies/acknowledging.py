"""Somebody in a workshop who acknowledges every alarm on the fleet's page, whatever happens to the page meanwhile.

What the page has confirmed must stand in the database and, once, in the audit.
"""

import re
import threading
from collections import Counter
from pathlib import Path

import httpx
from sqlalchemy import Engine, select

from fleet_backend.database import transaction
from fleet_backend.office_tables import ALARM, AUDIT

PAUSE_S = 0.3
PATIENCE_S = 20.0
PROXY_SECRET = "fedcba9876543210fedcba9876543210"  # noqa: S105 - of a test
WHO = "workshop@example.org"
_HEADERS = {"X-Forwarded-User": WHO, "X-Fleet-Proxy": PROXY_SECRET}
_TOKEN = re.compile(r'name="token" value="([0-9a-f]{64})"')

Key = tuple[str, int, str, int]
"""Vehicle, clutch, rule and number of an alarm."""


def write_access(folder: Path) -> Path:
    """Write the file of ``--access`` that lets the workshop in, and return it."""
    secret = folder / "proxy.secret"
    secret.write_text(PROXY_SECRET, encoding="utf-8")
    secret.chmod(0o600)
    access = folder / "access.toml"
    access.write_text(
        'host_names = ["127.0.0.1"]\n\n[proxy]\nuser_header = "X-Forwarded-User"\nsecret_header = "X-Fleet-Proxy"\n'
        f'secret_file = "{secret.name}"\n\n[roles]\nworkshop = ["{WHO}"]\n',
        encoding="utf-8",
    )
    return access


class Workshop:
    """A thread that reads alarms and acknowledges them.

    Attributes
    ----------
    confirmed
        Note of each alarm that the page said it had stored.
    unanswered
        How many requests got no answer, or that the database was away.
    """

    def __init__(self, address: str) -> None:
        self.confirmed: dict[Key, str] = {}
        self.unanswered = 0
        self._is_over = threading.Event()
        self._address = address
        self._thread = threading.Thread(target=self._work, name="workshop")
        self._thread.start()

    def end(self) -> None:
        self._is_over.set()
        self._thread.join()

    def _work(self) -> None:
        attempts = 0
        with httpx.Client(base_url=self._address, headers=_HEADERS, timeout=PATIENCE_S, trust_env=False) as page:
            while not self._is_over.wait(PAUSE_S):
                try:
                    waiting = self._answer(page.get("/api/v1/alarms", params={"state": "waiting"})).json()["alarms"]
                    for one in waiting:
                        attempts += 1
                        self._acknowledge(page, one, f"attempt {attempts}")
                except httpx.HTTPError:
                    self.unanswered += 1

    def _acknowledge(self, page: httpx.Client, alarm: dict[str, object], note: str) -> None:
        key = {"vehicle": alarm["vehicle"], "clutch": alarm["clutch"] or 0}
        key |= {"rule": alarm["rule"], "number": alarm["number"]}
        words = {name: str(word) for name, word in key.items()}
        token = _TOKEN.search(self._answer(page.get("/alarm", params=words)).text)
        if token is None:
            return  # an attempt that got no answer had been stored
        answer = page.post("/alarm/acknowledge", data={**words, "token": token[1], "note": note})
        if answer.status_code == httpx.codes.FORBIDDEN:
            return  # the page that made the form was killed, and its key with it
        if self._answer(answer).status_code == httpx.codes.SEE_OTHER:
            place = (words["vehicle"], int(words["clutch"]), words["rule"], int(words["number"]))
            self.confirmed[place] = note

    @staticmethod
    def _answer(answer: httpx.Response) -> httpx.Response:
        return answer if answer.status_code == httpx.codes.SEE_OTHER else answer.raise_for_status()


def broken_promises(engine: Engine, confirmed: dict[Key, str]) -> list[str]:
    """Return what does not agree among what the page confirmed, the alarms, and the audit, a line each."""
    with transaction(engine) as connection:
        alarms = connection.execute(select(ALARM).where(ALARM.c.acknowledged_at.is_not(None))).all()
        entries = Counter(
            row.subject for row in connection.execute(select(AUDIT).where(AUDIT.c.action == "acknowledge alarm"))
        )
    stored = {(one.vehicle, one.clutch, one.rule, one.number): one.note for one in alarms}
    found = [f"{key}: confirmed, not stored" for key, note in confirmed.items() if stored.get(key) != note]
    found += [f"{subject}: {count} times in the audit" for subject, count in entries.items() if count > 1]
    if sum(entries.values()) != len(stored):
        found.append(f"{len(stored)} alarms are acknowledged, the audit has {sum(entries.values())}")
    return found
