"""``diag-service dtc``: the trouble codes of a controller, with what it kept of the moment of failure."""

from types import SimpleNamespace

from diag_service.commands.asking import Answer, Wish, ask_one
from diag_service.service.stopping import Controls
from diag_service.tester.addresses import hexadecimal
from diag_service.tester.answers import request_text
from diag_service.tester.description import Description
from diag_service.tester.dialogue import Dialogue
from diag_service.tester.reading import read_troubles, trouble_request
from diag_service.tester.trouble_report import trouble_lines, trouble_record


def execute(options: SimpleNamespace, controls: Controls) -> None:
    """Read trouble codes and show them."""
    mask = 0 if options.all else hexadecimal(options.mask, "--mask", 0xFF)

    def wish(_: Description) -> Wish:
        details = [] if options.brief else ["19 04 and 19 06: what was kept of each code"]
        return Wish(schema="dtc", requests=[f"{request_text(trouble_request(mask))}: the codes", *details])

    def use(tester: Dialogue, description: Description) -> Answer:
        codes = read_troubles(tester, description, mask, has_details=not options.brief)
        return {"codes": [trouble_record(code) for code in codes]}, trouble_lines(codes)

    ask_one(options, wish, use, controls.stop)
