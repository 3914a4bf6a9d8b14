"""The report: one HTML file that needs nothing but itself."""

import base64
from collections.abc import Mapping, Sequence
from html import escape

from studies.reproduce.evidence import PRIOR_FACTORS, StaticEvidence
from studies.reproduce.pictures import Picture
from studies.reproduce.tables import PaperTable

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #22303c; max-width: 62rem; margin: 2.5rem auto; padding: 0 1rem; }
h1 { font-size: 1.7rem; line-height: 1.2; } h2 { margin-top: 2.4rem; font-size: 1.25rem; }
table { border-collapse: collapse; margin: .8rem 0; font-variant-numeric: tabular-nums; font-size: .88rem; }
th, td { padding: .25rem .5rem; text-align: right; border-bottom: 1px solid #e3e8ec; } td { white-space: nowrap; }
th { border-bottom: 1.5px solid #6b7a88; font-weight: 600; vertical-align: bottom; }
th.set { border-bottom: none; text-align: center; color: #6b7a88; font-weight: 500; }
td:first-child, th:first-child { text-align: left; }
caption { text-align: left; padding-bottom: .4rem; font-weight: 600; }
tr.first td { border-top: 1px solid #b9c4cd; } .scroll { overflow-x: auto; width: max-content;
max-width: min(96vw, 90rem); position: relative; left: 50%; transform: translateX(-50%); }
figure { margin: 1.6rem 0; } img { max-width: 100%; height: auto; }
figcaption, .note { color: #55636f; font-size: .92rem; }
"""


def page(text: str, tables: Mapping[str, str], pictures: Sequence[Picture]) -> str:
    """Return the report as HTML.

    Parameters
    ----------
    text : str
        Blocks between empty lines: ``# title``, ``## heading``, ``[[table]]``, anything else a paragraph.
    tables : mapping
        HTML by the names that the text calls.
    """
    blocks = text.strip().split("\n\n")
    title = escape(blocks[0].removeprefix("# "))
    body = [_block(block, tables) for block in blocks]
    body += ["<h2>Pictures 5 to 16</h2>", *(_figure(picture) for picture in pictures)]
    return (
        f'<!doctype html>\n<html lang="en"><head><meta charset="utf-8"><title>{title}</title>'
        '<meta name="viewport" content="width=device-width, initial-scale=1">'
        f"<style>{STYLE}</style></head><body>\n" + "\n".join(body) + "\n</body></html>\n"
    )


def study_table(table: PaperTable) -> str:
    """Return a table of parameter sets as HTML."""
    groups = "".join(f'<th class="set" colspan="{len(one.columns)}">{escape(one.title)}</th>' for one in table.sets)
    sets = f'<tr><th class="set" colspan="3"></th>{groups}</tr>'
    cases = [key[0] for key in table.keys]
    starts = [k > 0 and cases[k] != cases[k - 1] for k in range(len(cases))]
    headings = [heading.split(" (")[0] for heading in table.headings]  # whose they are stands above them
    return _table(table.caption, headings, table.rows, sets, starts)


def plain_table(caption: str, headings: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return any table as HTML."""
    return _table(caption, headings, rows, "", [False] * len(rows))


EVIDENCE_HEADINGS = (
    "parameter set",
    "clutch",
    "samples in µS",
    "of them locked",
    "of them truly slow slip",
    "µi before the 20 % gate, % of µS: mean",
    "scatter",
    *(f"error % of µS, gate around {factor:.1f} µS" for factor in PRIOR_FACTORS),
    "dµS / dprior",
    "error % after passes 1 .. 5",
)


def evidence_rows(evidence: Sequence[StaticEvidence]) -> list[list[str]]:
    """Return the evidence on mu_S as texts, columns as in the headings."""
    return [
        [
            one.case,
            str(one.clutch),
            f"{one.passed_count:.0f}",
            f"{100.0 * one.locked_share:.0f} %",
            f"{100.0 * one.slow_share:.0f} %",
            f"{one.ungated_mean_percent:+.0f}",
            f"{one.ungated_std_percent:.0f}",
            *(f"{error:+.1f}" for error in one.error_by_prior_percent),
            f"{one.pull:.2f}",
            " ".join(f"{error:+.1f}" for error in one.error_by_pass_percent),
        ]
        for one in evidence
    ]


def _block(block: str, tables: Mapping[str, str]) -> str:
    if block.startswith("[["):
        return tables[block.strip("[]\n")]
    for mark, tag in (("## ", "h2"), ("# ", "h1")):
        if block.startswith(mark):
            return f"<{tag}>{escape(block.removeprefix(mark))}</{tag}>"
    return f"<p>{escape(block)}</p>"


def _table(
    caption: str, headings: Sequence[str], rows: Sequence[Sequence[str]], sets: str, starts: Sequence[bool]
) -> str:
    head = "".join(f"<th>{escape(heading)}</th>" for heading in headings)
    body = "".join(
        ('<tr class="first">' if is_start else "<tr>") + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>"
        for row, is_start in zip(rows, starts, strict=True)
    )
    return (
        f'<div class="scroll"><table><caption>{escape(caption)}</caption><thead>'
        f"{sets}<tr>{head}</tr></thead><tbody>{body}</tbody></table></div>"
    )


def _figure(picture: Picture) -> str:
    data = base64.b64encode(picture.png).decode("ascii")
    caption = escape(f"Figure {picture.number}. {picture.caption}")
    return (
        f'<figure><img alt="{caption}" src="data:image/png;base64,{data}"><figcaption>{caption}</figcaption></figure>'
    )
