"""docs/model.md against the code: every equation that is cited exists."""

import re

from tests.support.distributions import ROOT, modules_of

MODEL = (ROOT / "docs" / "model.md").read_text(encoding="utf-8")
PACKAGES = ("studies", "clutch_model", "diag_service", "ecu_emulator")
LABEL = r"[A-Z]?\d+[a-z]?"


def test_every_equation_that_the_code_cites_is_in_the_document() -> None:
    known = set(re.findall(rf"\(({LABEL})\)", MODEL))
    cited = {
        (label, path.name)
        for package in PACKAGES
        for path in modules_of(package)
        for citation in re.findall(r"\beqs?\. ((?:\([^)]+\)(?:, | and | to )?)+)", path.read_text(encoding="utf-8"))
        for label in re.findall(rf"\(({LABEL})\)", citation)
    }
    assert len(cited) > 40
    assert {one for one in cited if one[0] not in known} == set()
