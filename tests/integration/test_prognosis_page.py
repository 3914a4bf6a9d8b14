"""The Python of docs/prognosis.md runs as it stands."""

import re

from diag_service.diagnosis.prognosis import Prognosis
from tests.support.documents import page_text
from tests.support.histories import history

BLOCK = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)


def test_the_block_of_the_page_runs() -> None:
    names: dict[str, object] = {"results": history(60), "fills": ()}
    (block,) = BLOCK.findall(page_text("docs/prognosis.md"))
    exec(compile(block, "docs/prognosis.md", "exec"), names)  # noqa: S102 - what the page is for
    found = names["found"]
    assert isinstance(found, Prognosis)
    assert found.change_fluid is not None
