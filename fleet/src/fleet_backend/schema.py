"""The tables of the fleet database, the same for SQLite and PostgreSQL; migrations create them.

What can be derived is not stored: the running condition, trends and alarms are views over the results, so they are the
same whatever the order in which results arrive.
"""

from datetime import UTC, datetime, timedelta
from typing import Final

from sqlalchemy import (
    BigInteger,
    Boolean,
    Column,
    DateTime,
    Dialect,
    Double,
    ForeignKey,
    ForeignKeyConstraint,
    Index,
    MetaData,
    SmallInteger,
    Table,
    Text,
    text,
)
from sqlalchemy.types import TypeDecorator

from clutchdiag_io import people

FRICTION_COLUMNS: Final = (
    "mu_c",
    "mu_s",
    "std_mu_c",
    "std_mu_s",
    "correlation",
    "random_std_mu_c",
    "random_std_mu_s",
    "slope_s_rad",
    "std_slope_s_rad",
    "probability_negative_slope",
)
FRICTION_TIER: Final = 1  # of a vehicle whose signals suffice for friction; a larger one is less
RUNNING: Final = "running_"  # prefix of what is said of the running estimate after the shift
SCALE_FREE_COLUMNS: Final = ("mu_c", "mu_s", "std_mu_c", "std_mu_s", "correlation")
SCALE_FREE: Final = "scale_free_"  # prefix of what driving alone tells, gain and area left out

DATED_NS: Final = people.DATED_NS
CLOCK_ERROR: Final = timedelta(days=1)  # of a vehicle; a moment that is farther ahead is none
_DATED: Final = f"{{0}}produced_at >= '{datetime.fromtimestamp(DATED_NS // 10**9, UTC)}'"
# An undated result is as old as its row: the clock of its vehicle was not set. Months go by this.
AGED_AT: Final = f"CASE WHEN {_DATED} THEN {{0}}produced_at ELSE {{0}}stored_at END"
# When an event was, as far as the bus tells: a log is no newer for a late analysis.
HAPPENED_AT: Final = f"CASE WHEN {{0}}end_bus_ns >= {DATED_NS} THEN {{0}}end_at ELSE {AGED_AT} END"
# What is the latest, by database: nothing can be newer than its arrival, whatever a clock says.
RANKED_AT: Final = {
    name: f"{least}({{0}}stored_at, {AGED_AT}, {HAPPENED_AT})"
    for name, least in (("sqlite", "min"), ("postgresql", "least"))
}
# The first part finds the months.
IS_OLD: Final = f"({{0}}produced_at < :until AND ({_DATED} OR {{0}}stored_at < :until))"
SORTED_BY_BYTES: Final = Text().with_variant(Text(collation="C"), "postgresql")  # as SQLite sorts everywhere


class UtcDateTime(TypeDecorator[datetime]):
    """An aware moment; SQLite forgets the zone, so it is UTC there by agreement."""

    impl = DateTime(timezone=True)
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        """Return the moment as the database keeps it."""
        if value is None or dialect.name != "sqlite":
            return value
        return value.astimezone(UTC).replace(tzinfo=None)

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        if value is None:
            return None
        return value.replace(tzinfo=UTC) if dialect.name == "sqlite" else value.astimezone(UTC)


METADATA: Final = MetaData()

VEHICLE: Final = Table(
    "vehicle",
    METADATA,
    Column("vehicle", Text, primary_key=True),
    Column("is_online", Boolean),
    Column("connected_at", UtcDateTime),
    Column("service_version", Text),
    Column("algorithm_version", Text),
    Column("calibration_version", Text),
    Column("metrics", Text),  # JSON object of the last numbers of its service
    Column("metrics_at", UtcDateTime),
    Column("controller", Text),  # JSON object: what a controller last said of its trouble codes
    Column("controller_at", UtcDateTime),
)

CLUTCH: Final = Table(
    "clutch",
    METADATA,
    Column("vehicle", Text, ForeignKey("vehicle.vehicle"), primary_key=True),
    Column("clutch", SmallInteger, primary_key=True, autoincrement=False),
    Column("element", Text),  # its name in the description of the transmission; null: clutch 1 or 2 of a pair
)

SHIFT_RESULT: Final = Table(
    "shift_result",
    METADATA,
    Column("vehicle", Text, primary_key=True),
    Column("stream", SORTED_BY_BYTES, primary_key=True),
    Column("seq", BigInteger, primary_key=True, autoincrement=False),
    Column("version_rank", SORTED_BY_BYTES, primary_key=True),  # of both versions; greater is newer
    Column("algorithm_version", Text, nullable=False),
    Column("calibration_version", Text, nullable=False),
    Column("clutch", SmallInteger, nullable=False),
    Column("number", BigInteger, nullable=False),
    Column("produced_at", UtcDateTime, nullable=False),
    Column("start_at", UtcDateTime, nullable=False),
    Column("end_at", UtcDateTime, nullable=False),
    Column("start_bus_ns", BigInteger, nullable=False),
    Column("end_bus_ns", BigInteger, nullable=False),
    Column("duration_s", Double, nullable=False),
    Column("from_gear", BigInteger, nullable=False),
    Column("to_gear", BigInteger, nullable=False),
    Column("status", Text, nullable=False),
    Column("reasons", Text, nullable=False),  # joined by commas
    *(Column(name, Double) for name in FRICTION_COLUMNS),
    Column("sample_count", BigInteger, nullable=False),
    Column("window_s", Double, nullable=False),
    Column("chi_square_ratio", Double, nullable=False),
    Column("quality", Double, nullable=False),
    Column("sump_temperature_k", Double),
    Column("clutch_temperature_k", Double),
    Column("slip_energy_j", Double),
    Column("odometer_m", Double),
    Column("condition", Text, nullable=False),
    Column("condition_reason", Text, nullable=False),
    Column("level_ratio", Double),
    *(Column(RUNNING + name, Double) for name in FRICTION_COLUMNS),
    Column("running_shift_count", BigInteger, nullable=False),
    Column("content_digest", BigInteger, nullable=False),  # tells two contents under one key apart
    Column("stored_at", UtcDateTime, nullable=False, server_default=text("CURRENT_TIMESTAMP")),
    Column("kind", Text),  # of the event, and how it ended; null in results of older programs
    Column("end_reason", Text),
    Column("advice", Text),  # of the verdict; null in results of older programs
    *(Column(SCALE_FREE + name, Double) for name in SCALE_FREE_COLUMNS),  # these and the next: null in older rows
    Column("trust", Double),  # how far the data can be believed, whatever the estimate
    Column("trust_parts", Text),  # JSON object of what that is made of
    Column("shift_quality", Text),  # JSON object: how well the event went, as its message tells
    Column("element", Text),  # name of the clutch
    Column("causes", Text),  # JSON object: why the vehicle is as it is, the likeliest causes alone
    Column("running_since_bus_ns", BigInteger),  # start of the first event in the running estimate, of another drive
    Column("tier", SmallInteger),  # what the vehicle's signals suffice for, 1 is friction; null: of an older schema
    Column("indices", Text),  # JSON object: what speeds and torques tell of the event, where they do not tell friction
    # In PostgreSQL clutch_stream has it: once for a stream, in place of once for each result.
    ForeignKeyConstraint(["vehicle", "clutch"], ["clutch.vehicle", "clutch.clutch"]).ddl_if(dialect="sqlite"),
    Index("shift_by_time", "vehicle", "clutch", "produced_at", "stream"),
    Index("shift_by_arrival", "stored_at"),
    Index(
        "shift_alarming",
        "vehicle",
        "clutch",
        postgresql_where=text("condition = 'change_fluid'"),
        sqlite_where=text("condition = 'change_fluid'"),
    ),
    postgresql_partition_by="RANGE (produced_at)",
)

QUARANTINE: Final = Table(
    "quarantine",
    METADATA,
    Column("digest", Text, primary_key=True),  # sha256 of topic and payload: the same poison is kept once
    Column("topic", Text, nullable=False),
    Column("vehicle", Text),  # as the topic says
    Column("reason", Text, nullable=False),
    Column("detail", Text, nullable=False),
    Column("size_bytes", BigInteger, nullable=False),
    Column("head", Text, nullable=False),  # the start of the payload, fit to be shown
    Column("received_at", UtcDateTime, nullable=False),
    Column("acknowledged_at", UtcDateTime),
    Column("acknowledged_by", Text),
    Index("quarantine_by_time", "received_at"),
)

FLUID_FILL: Final = Table(
    "fluid_fill",
    METADATA,
    Column("vehicle", Text, ForeignKey("vehicle.vehicle"), primary_key=True),
    Column("filled_at", UtcDateTime, primary_key=True),
    Column("odometer_m", Double),
    Column("product", Text, nullable=False),
    Column("note", Text),
)

WITHDRAWN_FILL: Final = Table(  # noted by mistake; they are in the table of fills no more
    "withdrawn_fill",
    METADATA,
    Column("vehicle", Text, primary_key=True),
    Column("filled_at", UtcDateTime, primary_key=True),
)

CALIBRATION: Final = Table(  # as the status of a service tells it: a vehicle speaks for itself alone
    "calibration",
    METADATA,
    Column("vehicle", Text, primary_key=True),
    Column("calibration_version", Text, primary_key=True),
    Column("content", Text, nullable=False),  # JSON object: the type, and the friction of each clutch when new
)

REVISION: Final = Table(  # what a result made of an earlier one, whichever comes first
    "revision",
    METADATA,
    Column("vehicle", Text, primary_key=True),
    Column("stream", SORTED_BY_BYTES, primary_key=True),
    Column("seq", BigInteger, primary_key=True, autoincrement=False),
    Column("clutch", SmallInteger, primary_key=True, autoincrement=False),
    Column("end_bus_ns", BigInteger, primary_key=True, autoincrement=False),
    Column("content", Text, nullable=False),  # JSON object: columns of the earlier result as they are now
)

# What makes a result that result. In PostgreSQL the time of its making is in the primary key as well: no unique index
# of a partitioned table can do without; the views take one result per key all the same.
KEY_COLUMNS: Final = tuple(column.name for column in SHIFT_RESULT.primary_key)
SHIFT_RESULT.primary_key.ddl_if(dialect="sqlite")  # PostgreSQL's is made with the months
RANK_INDEX: Final = Index(
    "shift_by_rank",
    *(SHIFT_RESULT.c[name] for name in ("vehicle", "clutch")),
    text(RANKED_AT["sqlite"].format("")),
    SHIFT_RESULT.c.stream,
).ddl_if(dialect="sqlite")

# What two contents of one result may differ in: it is not in the digest, which must stay what it was.
UNHASHED_COLUMNS: Final = frozenset({
    *("stored_at", "content_digest", "version_rank", "kind", "end_reason", "advice", "trust", "trust_parts"),
    *("shift_quality", "element", "causes", "running_since_bus_ns", "tier", "indices"),
    *(SCALE_FREE + name for name in SCALE_FREE_COLUMNS),
})  # fmt: skip
