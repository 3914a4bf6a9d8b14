"""A lake made by a ``LocalCluster`` of Dask, whose parts are processes that nobody started by hand.

python -m tests.tools.local_cluster --logs 20
"""

import argparse
import subprocess
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from clutch_model.calibration import nominal_calibration
from diag_service.lake.parts import Disagreement, Manifest, disagreement
from diag_service.lake.places import Place
from diag_service.lake.pools import ClusterAddress, load_distributed, security
from diag_service.lake.run import LakeTotals, fill_lake, find_logs
from diag_service.lake.work import Job
from diag_service.service.stopping import Trigger
from diag_service.settings.config import DiagnosisConfig
from fleet_link import TlsFiles
from tests.support.cluster import make_certificates
from tests.tools.folders import fill_folder


def filled(folder: Path, logs: Path, address: str, tls: TlsFiles) -> LakeTotals:
    """Bring a lake up to date by a cluster."""
    config = DiagnosisConfig(vehicle="car", calibration=nominal_calibration())
    lake = Place(str(folder / "lake"))
    found = find_logs([str(logs)], lake, "car", has_vehicles=False)
    job = Job.of(config, lake.address, None, 600.0)
    return fill_lake(job, found, ClusterAddress.parse(address, tls), jobs=1, stream=sys.stderr, stop=Trigger())


def main(arguments: Sequence[str] | None = None) -> int:
    """Do it twice and print what was found; the status is 0 if every log is in the lake once."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--logs", type=int, default=20)
    options = parser.parse_args(arguments)
    with TemporaryDirectory() as name:
        folder = Path(name)
        log = folder / "cycle.log"
        subprocess.run([sys.executable, "-m", "ecu_emulator", "record", str(log)], check=True, capture_output=True)
        fill_folder(folder / "logs", log, options.logs)
        words = make_certificates(folder / "certificates")
        tls = TlsFiles(authority=Path(words[1]), certificate=Path(words[3]), key=Path(words[5]))
        with load_distributed().LocalCluster(
            n_workers=2, threads_per_worker=1, processes=True, host="127.0.0.1", protocol="tls",
            security=security(tls), dashboard_address="127.0.0.1:0",
        ) as cluster:  # fmt: skip
            first = filled(folder, folder / "logs", cluster.scheduler_address, tls)
            second = filled(folder, folder / "logs", cluster.scheduler_address, tls)
        lake = Place(str(folder / "lake"))
        found = disagreement(lake)
        counts = Counter(row.source for row in Manifest(lake).rows)
    print(f"first: {first}\nsecond: {second}\n{found}")
    is_right = (
        first.done == second.before - 1 == options.logs  # the one is no log
        and second.done == second.failed == 0
        and set(counts.values()) == {1}
        and found == Disagreement(missing=(), unknown=(), twice=())
    )
    return 0 if is_right else 1


if __name__ == "__main__":
    raise SystemExit(main())
