"""What was read of the tables of the tests; ``python -m canlog_tests.logs.table_goldens`` renews it."""

import io
import json
import zlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from canlog.errors import CanlogError
from canlog.frames import join
from canlog.logs.detection import detect
from canlog.logs.log_counts import LogCounts
from canlog.logs.signal_tables import read_signal_table
from canlog_tests.logs import test_signal_tables, test_tables_of_programs

PATH: Final = Path(__file__).with_name("table_goldens.json")
CAR_SCANNER_LATE: Final = '"35900.1";"TCC slip";"17.5";"rpm";"45.79";"15.72";\r\n'


def tables() -> Mapping[str, bytes]:
    """Return tables of every layout that was read when they were stored, some of them with odd cells and lines."""
    programs, drive = test_tables_of_programs, test_tables_of_programs.drive()
    groups = programs.vcds(drive, has_groups=True)
    plain = test_signal_tables.WRITERS["plain"]
    later = ["Device Time,Speed(km/h),Engine RPM(rpm)", *(f"{t}.0,{t},{900 + t}" for t in range(30, 60))]
    later += ["Device Time,Engine RPM(rpm),Boost(psi),Speed(km/h)", *(f"{t}.0,{900 + t},1,{t}" for t in range(60, 90))]
    tuner = ["HP Tuners CSV Log File", "Version: 1.0", "", "[Channel Information]", "0,4311,99,7"]
    tuner += ["Offset,Engine RPM (SAE),AEM 30-(03x0,2340,5130),Gear", "s,rpm,rpm,", "", "[Channel Data]"]
    tuner += [f"{t / 20:.3f},{1500 + t},{t},4" for t in range(30)]
    other_pace = [f"{n / 20:.2f},{800 + n},{n / 5:.1f},{80 + n % 3}" for n in range(60)]
    gears = [f"{n / 10:.1f};{'N' if n % 7 == 3 else n % 7};{n / 3:.2f}".replace(".", ",") for n in range(60)]
    return {
        **{f"writer: {name}": text for name, text in test_signal_tables.WRITERS.items()},
        **{f"program: {name}": write(drive).encode() for name, write in programs.WRITERS.items()},
        "code page of Windows": programs.vcds(drive).encode("cp1252"),
        "groups in the code page": groups.encode("cp1252"),
        "group that ends early": programs.vcds(programs.drive(5)).replace(",1.88,80.0,\n", ",,,\n").encode(),
        "signal that comes late": (programs.car_scanner(programs.drive(100)) + CAR_SCANNER_LATE).encode(),
        "later header": "\n".join([*later, ""]).encode(),
        "tuner": "\n".join([*tuner, ""]).encode(),
        "cut off": plain + b"10.148,1004.25,123.456",
        "odd cells": b"Time [s],A,B\n1.0,1,\n1.1,,2\n1.2,nan,oops\n1.3,4,5\n1.4,1e999,6\n1.5,7\nx,8,9\n"
        + b"".join(b"%d,0,0\n" % second for second in range(2, 12)),
        "grouped": b"Time [s],Speed,Odd\n" + b"".join(b'%d,"1,%03d",%d\n' % (n, n, n % 3) for n in range(40)),
        "decimal comma": "\n".join(["Zeit [s];Druck [bar];Gang", *gears, ""]).encode(),
        "another clock": "\n".join(["Time,RPM,Slow Time,Oil Temp", *other_pace, ""]).encode(),
        "no time": b"name,grade,year\nann,1,1999\nbob,2,1998\ncid,1,1997\ndan,3,1996\n",
        "steps of ms": b"Time,A\n" + b"".join(b"%d,%d\n" % (1000 + 37 * n, n) for n in range(40)),
        "since 1970 in ms": b"t,A\n" + b"".join(b"%d,%d\n" % (1785952676240 + 40 * n, n) for n in range(40)),
        "unnamed first": b"x,A\n" + b"".join(b"%.2f,%d\n" % (n / 20, n * n % 17) for n in range(40)),
        "over midnight": b"Time,A\n" + b"".join(b"%02d:59:%02d,%d\n" % (23, n, n) for n in range(60))
        + b"".join(b"00:00:%02d,%d\n" % (n, n) for n in range(60)),
        "blank lines and sections": b"[Data]\nTime;A\n\n[Rows]\n" + b"".join(b"%d;%d\n\n" % (n, n) for n in range(40)),
        "two clocks of numbered names": b"time 1,A,time 2,B\n"
        + b"".join(b"%.1f,%d,%.2f,%d\n" % (n / 10, n, n / 10 + 0.05, 2 * n) for n in range(40)),
    }  # fmt: skip


def outcome(text: bytes) -> dict[str, Any]:
    """Return what detection says of a table and what is read of it, values and times as a sum and in extracts."""
    try:
        detected = detect(text)
        if not detected.columns:
            return {"format": detected.format.value}
        counts = LogCounts()
        batch = join(list(read_signal_table(io.BytesIO(text), counts)))
    except CanlogError as exc:
        return {"refused": type(exc).__name__}
    values = batch.data[:, :8].copy().view("<f8").ravel()
    return {
        "evidence": detected.evidence,
        "columns": [list(column) for column in detected.columns],
        "notes": list(counts.notes),
        "rejected": {reason.value: count for reason, count in counts.rejected.items()},
        "first_rejected": counts.first_rejected,
        "truncated": counts.truncated,
        "frames": len(batch),
        "first": [[int(batch.t_ns[row]), float(values[row])] for row in range(min(len(batch), 4))],
        "sum": zlib.crc32(batch.t_ns.tobytes() + batch.can_id.tobytes() + values.tobytes()),
    }


def main() -> None:
    outcomes = {name: outcome(text) for name, text in tables().items()}
    PATH.write_text(json.dumps(outcomes, indent=1, ensure_ascii=False) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
