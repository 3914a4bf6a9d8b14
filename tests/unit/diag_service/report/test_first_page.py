"""The first page of a report: what a workshop asks, and what paper gets of the rest."""

import re
from dataclasses import replace

from diag_service.diagnosis.records import FluidFill
from diag_service.report.page import html_of, page_of
from tests.support.histories import findings

NOW = "2026-03-01T12:00:00.000000Z"
FILL = FluidFill(vehicle="car1", filled_at="2025-06-01T00:00:00.000000Z", odometer_m=500_000.0, product="DCTF 75W")


def first_section(html: str) -> str:
    return html[html.index("<section") : html.index("</section>")]


def test_a_workshop_reads_all_it_needs_before_any_detail() -> None:
    found = replace(findings(30), fills=(FILL,))
    html = html_of(page_of(found, NOW))
    text = " ".join(re.sub(r"<[^>]+>", " ", first_section(html)).split())
    odometer = f"odometer [km] {(found.results[-1].estimate.odometer_m or 0.0) / 1000.0:.0f} "
    for told in ("km left", odometer, "fluid DCTF 75W", "filled on 2025-06-01", "filled at [km] 500"):
        assert told in text
    assert html.index(found.order.text) < html.index("<section")
    assert first_section(html).count("<svg") == 1
    assert "watch: 90 %" in text
