"""The table of clients in docs/controller-tables.md is one that the command makes; the command sees differences."""

import re

from tests.support.uds.clients_script import CLIENTS
from tests.tools.uds_clients import DOCUMENT, READERS, Told, differences, services, table_of

SESSION = ("10 03", "50 03 00 32 01 f4")
SEED = "67 01 01 02 03 04"


def test_the_page_has_every_client_reader_and_service() -> None:
    (block,) = re.findall(r"<!-- clients -->\n(.*?)<!-- end -->", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)
    head, _, *rows = [[cell.strip() for cell in line.split("|")[1:-1]] for line in block.splitlines()]
    assert head == ["service", *CLIENTS, *READERS]
    assert [row[0] for row in rows] == services()
    assert {cell for row in rows for cell in row[1:]} <= {"yes", "no", "-"}
    by_service = {row[0]: dict(zip(head, row, strict=True)) for row in rows}
    asked = {name: [service for service in services() if by_service[service][name] != "-"] for name in CLIENTS}
    answered = {name: [service for service in services() if by_service[service][name] == "yes"] for name in CLIENTS}
    assert answered == {**asked, "python-OBD": ["01", "03", "04", "06", "07", "09"]}
    assert asked["scapy"] == [*asked["udsoncan"][:-1], "2A", "11"]


def test_a_table_says_what_was_answered_and_what_was_not_asked() -> None:
    told: dict[str, Told] = {
        "one": {"10 03": SESSION, "3e 00": ("3e 00", "7f 3e 11")},
        "other": {"22 f1 90": ("22 f1 90", "")},
    }
    lines = table_of(told, {"tshark": {"10"}}).splitlines()
    assert lines[0] == "| service | one | other | tshark |"
    assert lines[2:5] == ["| 10 | yes | - | yes |", "| 3E | no | - | - |", "| 22 | - | no | - |"]


def test_an_answer_or_a_request_that_differs_is_told_but_for_seeds() -> None:
    same: Told = {"10 03": SESSION, "27 01": ("27 01", SEED)}
    assert differences({"one": same, "other": {**same, "27 01": ("27 01", "67 01 09 09 09 09")}}) == []
    answered = {**same, "10 03": ("10 03", "50 03 00 32 01 f5")}
    assert differences({"one": same, "other": answered}) == [
        f"10 03: {{'one': '{SESSION[1]}', 'other': '50 03 00 32 01 f5'}}"
    ]
    assert differences({"one": {"2f 02 06 03 78": ("2f 02 06 03", "7f 2f 13")}}) == [
        "one sent 2f 02 06 03 for 2f 02 06 03 78"
    ]
