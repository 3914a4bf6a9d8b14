"""Which profile fits a database, where the user names none."""

from dataclasses import dataclass

from cantools.database.can import Database

from diag_service.diagnosis.columns import Signal
from diag_service.diagnosis.records import Tier
from diag_service.errors import ConfigError
from diag_service.mapping.mapped_messages import fitting
from diag_service.mapping.profile import Profile, load_shipped, shipped_profiles
from diag_service.mapping.tiers import missing_for_next, tier_of

MAX_COMPLAINTS = 3  # of a profile that does not fit: enough to see how far off it is


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """How well a profile fits a database."""

    profile: Profile
    tier: Tier | None
    signals: frozenset[Signal]
    problems: tuple[str, ...]

    @property
    def said(self) -> str:
        """The fit in words, with what the next better tier would need."""
        text = f"profile {self.profile.name}: {len(self.signals)} of {len(self.profile.sources)} signals"
        missing = missing_for_next(self.signals, knows_gears=self.profile.gears is not None)
        return f"{text}, tier {self.tier or 'none'}{f'; {missing}' if missing else ''}"


def fit_of(database: Database, profile: Profile) -> Fit:
    """Return how well a profile fits a database."""
    mapped, problems = fitting(database, profile)
    signals = frozenset(column.signal for message in mapped for column in message.columns)
    tier = tier_of(signals, knows_gears=profile.gears is not None)
    return Fit(profile=profile, tier=tier, signals=signals, problems=problems)


def choose_profile(database: Database) -> Fit:
    """Return the shipped profile that gets most out of a database.

    Raises ConfigError if not even shifts can be found with any of them; the text says what is missing.
    """
    fits = [fit_of(database, load_shipped(name)) for name in shipped_profiles()]
    usable = [fit for fit in fits if fit.tier is not None]
    if not usable:
        said = "; ".join(f"{fit.profile.name}: {', '.join(_shortened(fit.problems))}" for fit in fits)
        raise ConfigError(
            f"no shipped profile fits the database; 'diag-service signals' proposes one for --profile. {said}"
        )
    return min(usable, key=lambda fit: (fit.tier or Tier.KINEMATIC, -len(fit.signals) / len(fit.profile.sources)))


def _shortened(problems: tuple[str, ...]) -> list[str]:
    """Return the first of many complaints."""
    more = len(problems) - MAX_COMPLAINTS
    return [*problems[:MAX_COMPLAINTS], *([f"and {more} more"] if more > 0 else [])]
