"""The package that ships is what a SOVD stack wants of one, and every service of it is answered over DoIP.

What the stack wants is read in the public sources of Eclipse OpenSOVD: its converter of PDX packages resolves
references file by file and takes the revision from the container of a base variant; its classic diagnostic adapter
looks for protocols, communication parameters, faults and operations by these names. Neither program is run here.
"""

import re
import secrets
import time
import zipfile
from collections.abc import Iterator
from random import Random
from typing import Any
from unittest.mock import patch
from xml.etree import ElementTree as ET

import odxtools.exceptions
import pytest
from odxtools.diagservice import DiagService

from ecu_emulator import Emulator
from tests.support.documents import page_text
from tests.support.doip.tester import Tester, is_pending
from tests.support.patience import HANG_S
from tests.support.ports import free_port
from tests.support.uds.pdx_client import PARKED, PdxClient, read_back, templates_compiled_once
from tests.tools.pdx.package import FILE
from workshop import Answers
from workshop.controller.controller import Controller
from workshop.controller.doip_server import DoipAddress, DoipServer
from workshop.controller.iso14229 import DEFAULT_SESSION, Service
from workshop.controller.table import shipped_table

PAGE = "docs/sovd.md"
BASE_FILES = {
    "ISO_15765_2.odx-cs", "ISO_15765_3.odx-cs", "ISO_15765_3_on_ISO_15765_2.odx-c",
    "ISO_13400_2.odx-cs", "ISO_14229_5.odx-cs", "ISO_14229_5_on_ISO_13400_2.odx-c", "UDS_Ethernet_DoIP.odx-d",
}  # fmt: skip
DOIP_NAME = "UDS_Ethernet_DoIP"
CATEGORIES = ("DIAG-LAYER-CONTAINER", "COMPARAM-SPEC", "COMPARAM-SUBSET")


@pytest.fixture(scope="module", autouse=True)
def _compiled_once() -> Iterator[None]:
    with templates_compiled_once():
        yield


@pytest.fixture(name="documents", scope="module")
def _documents() -> dict[str, ET.Element]:
    """Return the files of ODX in their order."""
    with zipfile.ZipFile(FILE) as package:
        return {name: ET.fromstring(package.read(name)) for name in package.namelist() if ".odx" in name}  # noqa: S314 - our own


def category(document: ET.Element) -> ET.Element:
    return next(child for child in document if child.tag in CATEGORIES)


def test_the_base_files_have_the_names_that_the_stack_knows(documents: dict[str, ET.Element]) -> None:
    assert documents.keys() - {"TCU.odx-d", "TCU_OBD.odx-d"} == BASE_FILES
    page = page_text(PAGE)
    assert [name for name in BASE_FILES if name not in page] == []


def test_every_reference_leads_somewhere_in_the_file_that_it_names(documents: dict[str, ET.Element]) -> None:
    ids = {
        name: {entry.get("ID") for entry in document.iter() if entry.get("ID")} for name, document in documents.items()
    }
    named = {category(document).findtext("SHORT-NAME"): name for name, document in documents.items()}
    assert len(named) == len(documents)
    count = 0
    for name, document in documents.items():
        for entry in document.iter():
            if (target := entry.get("ID-REF")) is not None:
                count += 1
                place = named[entry.get("DOCREF")] if entry.get("DOCREF") else name
                assert target in ids[place], (name, target)
    assert count > 1000


def test_the_first_controller_is_ours_and_has_a_revision(documents: dict[str, ET.Element]) -> None:
    with_variant = [
        category(document) for document in documents.values() if document.find(".//BASE-VARIANT") is not None
    ]
    assert with_variant[0].findtext(".//BASE-VARIANT/SHORT-NAME") == "TCU"
    for container in with_variant:
        assert container.findtext("ADMIN-DATA/DOC-REVISIONS/DOC-REVISION/REVISION-LABEL") == "0100"


def test_protocols_and_addresses_are_found_by_their_names() -> None:
    table = shipped_table()
    raw: Any = read_back(FILE.read_bytes()).diag_layer_raw
    assert {entry.layer_ref.ref_id.removeprefix("LAYER.") for entry in raw.parent_refs} == {"UDS_CAN", DOIP_NAME}
    values: dict[tuple[str, str], Any] = {
        (str(entry.protocol_snref), entry.short_name): entry.value for entry in raw.comparam_refs
    }
    can = values["UDS_CAN", "CP_UniqueRespIdTable"]
    assert (can[1], can[4]) == (str(table.addressing.request_id), str(table.addressing.response_id))
    ip = values[DOIP_NAME, "CP_UniqueRespIdTable"]
    assert ip == [str(table.doip.logical_address), "0", "TCU"]
    assert values[DOIP_NAME, "CP_DoIPLogicalGatewayAddress"] == str(0x1011)
    assert values[DOIP_NAME, "CP_DoIPLogicalFunctionalAddress"] == str(0xE400)


def test_faults_and_operations_are_found_as_the_stack_looks_for_them() -> None:
    tcu = read_back(FILE.read_bytes())
    begins = {
        service.short_name: bytes(service.request.coded_const_prefix()) for service in tcu.services if service.request
    }
    (faults,) = (name for name, begin in begins.items() if begin[:2] == b"\x19\x02")
    assert faults == "Read_trouble_codes_by_status"
    for routine, verbs in {0x0301: 3, 0x0302: 3, 0x0303: 2}.items():
        names = {
            begin[1]: name
            for name, begin in begins.items()
            if begin[:1] == b"\x31" and begin[2:4] == routine.to_bytes(2, "big")
        }
        assert len(names) == verbs
        ends = {1: "_Start", 2: "_Stop", 3: "_RequestResults"}
        assert all(name.endswith(ends[sub]) for sub, name in names.items())
        assert len({name.removesuffix(ends[sub]) for sub, name in names.items()}) == 1


class OverIp(PdxClient):
    """Asks the controller behind a socket, unlocked; a routine that it begins is completed at once."""

    def __init__(self, controller: Controller, port: int) -> None:
        super().__init__(controller.table, Random(1))  # noqa: S311 - to be repeated
        self.layer = read_back(FILE.read_bytes())
        self._controller, self._port = controller, port

    def ask_each_once(self) -> None:
        """Ask each service, on a connection of its own: a reset closes it."""
        for service in self.layer.services:
            assert isinstance(service, DiagService)
            request = bytes(service.encode_request(**next(self.parameters(service))))
            while self._controller.is_asleep or self._controller.state.session != DEFAULT_SESSION:
                time.sleep(0.01)
            with Tester(self._port) as tester:
                tester.unlock()
                response = tester.first(request.hex(" "))
                if is_pending(response) and request[0] == Service.ROUTINE_CONTROL:
                    self._controller.finish(int.from_bytes(request[2:4], "big"))
                final = tester.final() if is_pending(response) else response
            self.figures.requests[service.short_name] += 1
            self.check(service, request, bytes.fromhex(final))


def test_the_package_loads_strictly_and_every_service_of_it_is_answered_over_ip() -> None:
    assert odxtools.exceptions.strict_mode
    values = {**PARKED, "odometer_m": 1e7, "time_s": 5.0}
    controller = Controller(shipped_table(), values=lambda: values, clock=time.monotonic, chance=secrets.token_bytes)
    place = DoipAddress(host="127.0.0.1", port=free_port())
    with DoipServer(controller, place):
        client = OverIp(controller, place.port)
        client.ask_each_once()
    figures = client.figures
    assert figures.problems == []
    assert len(figures.requests) == len(client.layer.services) == 70
    assert set(figures.positive) | set(figures.negative) == set(figures.requests)
    assert len(figures.positive) > len(figures.requests) * 3 // 4


def codes_of(port: int, mask: int) -> str:
    with Tester(port) as tester:
        return tester.first(f"19 02 {mask:02x}")


def test_the_page_reads_faults_and_starts_an_operation_by_the_names_of_the_package() -> None:
    """The page's order leads to the fault that the car here begins with; the code is there when the page asks."""
    (block,) = re.findall(r"^```python\n(import odxtools .*?)^```", page_text(PAGE), re.MULTILINE | re.DOTALL)
    (order,) = re.findall(r"^ecu-emulator control \S+ code (\w+)", page_text(PAGE), re.MULTILINE)
    port = free_port()
    ports = f"0x1011, tcp_port={port}, udp_port={port}"
    said: list[Any] = []
    with Emulator("ideal", is_endless=True, is_prompt=True, answers=Answers(doip=str(port))) as car:
        for fault in next(trouble.faults for trouble in shipped_table().troubles.values() if trouble.code == order):
            car.add_fault(fault)
        car.wait_until(1.0, HANG_S)  # its server is there before its first frame
        while len(codes_of(port, 0x04)) <= len("59 02 ff"):
            assert car.is_driving
        with patch("builtins.print", lambda *words: said.append(words)):
            exec(block.replace("0x1011", ports), {"__name__": "page"})  # noqa: S102 - what the page is for
    (speed,), *codes, (outcome,) = said
    assert speed == {"speed": 46.6}
    assert codes == [(f"{order}-64",)]  # the failure type behind it: signal plausibility
    assert outcome["response_code"] == "security access denied"
