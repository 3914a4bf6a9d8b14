"""Asks a controller everything its PDX describes: ``python -m tests.tools.uds_pdx [TABLE]``; status 1: not all fits.

odxtools reads the package, encodes every request in every session, and decodes what the controller answers; each
answer is encoded again and must give the same bytes. OBD by services 01 to 0A is a layer of its own.
"""

import sys
from pathlib import Path
from random import Random

from ecu_emulator.diagnostics.descriptions import Profile
from ecu_emulator.diagnostics.table_file import load_table, shipped_table
from tests.support.uds.full_table import full_table
from tests.support.uds.pdx_client import PdxClient


def shown(client: PdxClient) -> bool:
    """Ask everything of a layer, print how that went, and return whether all fits."""
    figures = client.ask_everything()
    asked, positive, negative = (sum(some.values()) for some in (figures.requests, figures.positive, figures.negative))
    silent = [name for name in figures.requests if not figures.positive[name]]
    print(f"{client.layer.short_name}: {len(figures.requests)} services, {asked} requests, all encoded by odxtools")
    print(f"{positive + negative} responses decoded and encoded again: {positive} positive, {negative} negative")
    print(f"negative response codes: {', '.join(f'{name} {count}' for name, count in figures.nrcs.most_common())}")
    print(f"never answered positively: {', '.join(silent) or 'none'}")
    print(f"not answered, not decoded or not the same again: {len(figures.problems)}")
    print("\n".join(figures.problems[:20]))
    return not (figures.problems or silent)


def main(words: list[str]) -> int:
    tables = [load_table(Path(words[0]))] if words else [full_table(), shipped_table()]
    clients = [PdxClient(tables[0], Random(1))]  # noqa: S311 - to be repeated
    if tables[-1].has_obd(Profile.CLASSIC):
        clients.append(PdxClient(tables[-1], Random(1), container=1))  # noqa: S311 - likewise
    fits = [shown(client) for client in clients]
    return int(not all(fits))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
