"""The audit: who changed what, by the page or by a command; a line is written in the transaction of its change."""

import uuid
from datetime import datetime
from typing import Final

from sqlalchemy import Connection, insert

from fleet_backend.office_tables import AUDIT

COMMAND_LINE: Final = "command line"  # the role of who has a shell where the database is open to him


def note_change(connection: Connection, *, at: datetime, who: str, role: str, action: str, subject: str) -> None:
    values = {"audit_id": str(uuid.uuid4()), "at": at, "who": who, "role": role, "action": action, "subject": subject}
    connection.execute(insert(AUDIT).values(**values))
