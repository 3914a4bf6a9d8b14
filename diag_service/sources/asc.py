"""Vector ASC logs, line by line, to columns.

Times are read as whole microseconds (further digits are rounded) and added to the start of the measurement. The file
gives that in local time without a zone, to the millisecond; python-can reads it in the same way.
"""

import re
from collections.abc import Iterator
from datetime import datetime
from typing import BinaryIO

import numpy as np

from diag_service.frames import ERROR_FLAG, EXTENDED_FLAG, PAYLOAD_BYTES, REMOTE_FLAG, FrameBatch
from diag_service.sources.tally import LogReject, Tally

FRAMES_PER_BATCH = 65_536
NS_PER_US = 1_000
US_PER_S = 1_000_000
EDL_FLAG = 0x1000  # in the flags of a CANFD line
MAX_EXTENDED_ID = 0x1FFF_FFFF
MAX_STANDARD_ID = 0x7FF

HEADER = re.compile(rb"(date|base|no\s+internal|internal|begin|end|//|previous\s+log|split)\b|//", re.IGNORECASE)
STARTS = re.compile(rb"(?:date|begin\s+triggerblock)\s+(?P<date>\w+\s.*)", re.IGNORECASE)
BASE = re.compile(rb"base\s+(?P<base>hex|dec)(?:\s+timestamps\s+(?P<kind>absolute|relative))?", re.IGNORECASE)
STAMPED = re.compile(rb"(?P<seconds>\d{1,10})\.(?P<fraction>\d{1,9})\s+(?P<rest>\S.*)")
CLASSIC = re.compile(
    rb"\d+\s+(?P<id>[0-9a-f]+)(?P<extended>x?)\s+(?:Rx|Tx|TxRq)\s+(?P<kind>[dr])"
    rb"(?:\s+(?P<length>[0-9a-f]+))?(?P<data>(?:\s+[0-9a-f]+)*)(?:\s+\w+\s*=.*)?$",
    re.IGNORECASE,
)
FD = re.compile(
    rb"CANFD\s+\d+\s+(?:Rx|Tx|TxRq)\s+(?P<id>[0-9a-f]+)(?P<extended>x?)\s+(?:(?![01]\s+[01]\s)\S+\s+)?[01]\s+[01]\s+"
    rb"(?P<length>[0-9a-f])\s+(?P<count>\d+)(?P<rest>(?:\s+[0-9a-f]+)*)\s*$",
    re.IGNORECASE,
)
ERROR = re.compile(rb"(?:CANFD\s+)?\d+\s+(?:(?:Rx|Tx)\s+)?ErrorFrame\b", re.IGNORECASE)
FRAME_LIKE = re.compile(rb"(?:CANFD\s+)?\d+\s+(?:\S+\s+(?:Rx|Tx|TxRq)\b|(?:Rx|Tx|TxRq)\s)", re.IGNORECASE)
MONTHS = {
    "jan": 1, "feb": 2, "mar": 3, "mär": 3, "apr": 4, "may": 5, "mai": 5, "jun": 6, "jul": 7, "aug": 8, "sep": 9,
    "oct": 10, "okt": 10, "nov": 11, "dec": 12, "dez": 12,
}  # fmt: skip
DATE = re.compile(
    r"\w+\s+(?P<month>\w{3})\w*\s+(?P<day>\d{1,2})\s+(?P<hour>\d{1,2}):(?P<minute>\d\d):(?P<second>\d\d)"
    r"(?:\.(?P<ms>\d{1,3}))?\s*(?P<half>am|pm)?\s+(?P<year>\d{4})",
    re.IGNORECASE,
)
