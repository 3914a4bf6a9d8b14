"""Cells of tables: what they hold is escaped, whatever it is."""

from clutchdiag_io.pages.content import NONE, Badge, Link, Number, TimeCell, rows_markup

EVIL = "<img src=x onerror=alert(1)>\"'&"
SAFE = "&lt;img src=x onerror=alert(1)&gt;&#34;&#39;&amp;"


def test_every_part_of_a_cell_is_escaped() -> None:
    cells = (
        EVIL,
        Link(text=EVIL, href=EVIL),
        Badge(style=EVIL, text=EVIL),
        TimeCell(iso=EVIL, text=EVIL),
        Number(value=0.1 + 0.2, text=EVIL),
        NONE,
    )
    assert rows_markup([cells, cells[:1]]) == (
        f'<tr><th scope="row">{SAFE}</th>'
        f'<td><a href="{SAFE}">{SAFE}</a></td>'
        f'<td><span class="{SAFE}"><strong class="badge">{SAFE}</strong></span></td>'
        f'<td><time datetime="{SAFE}">{SAFE}</time></td>'
        f'<td><data value="0.30000000000000004">{SAFE}</data></td>'
        f"<td>{NONE}</td></tr>\n"
        f'<tr><th scope="row">{SAFE}</th></tr>\n'
    )
