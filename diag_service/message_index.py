"""Which message of a database a frame is, for whole batches: by identifier, else by J1939 parameter group."""

import numpy as np
from cantools.database.can import Database, Message

from diag_service.frames import ERROR_FLAG, EXTENDED_FLAG, REMOTE_FLAG
from diag_service.records import Int64Array, UInt32Array
from diag_service.source_tables import group_of, parameter_group

J1939 = "j1939"


class MessageIndex:
    """Finds the messages of frames; what was looked up once is remembered."""

    def __init__(self, database: Database) -> None:
        self.messages: list[Message] = list(database.messages)
        self._by_id: dict[int, int] = {}
        self._by_group: dict[int, int] = {}
        for place, message in enumerate(self.messages):
            self._by_id.setdefault(message.frame_id | (EXTENDED_FLAG if message.is_extended_frame else 0), place)
            group = parameter_group(message)
            if group is not None and message.protocol == J1939:
                self._by_group.setdefault(group, place)

    def place(self, can_id: int) -> int:
        """Return the position of the message that an identifier with its flags names, -1 for none."""
        if can_id & (REMOTE_FLAG | ERROR_FLAG):
            return -1
        place = self._by_id.get(can_id, -1)
        if place < 0 and can_id & EXTENDED_FLAG:
            place = self._by_group.get(group_of(can_id & ~EXTENDED_FLAG), -1)
            self._by_id[can_id] = place
        return place

    def places(self, can_id: UInt32Array) -> Int64Array:
        """Return the position of the message of each frame, -1 for none, shape (n,)."""
        unique, inverse = np.unique(can_id, return_inverse=True)
        return np.array([self.place(one) for one in unique.tolist()], np.int64)[inverse]
