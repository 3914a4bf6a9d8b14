"""Prognosis: from the past results of one clutch to how far its fluid will go, with how sure that is."""

from clutch_results.prognosis.channels import ChannelName
from clutch_results.prognosis.fluid_lives import ageings
from clutch_results.prognosis.history import History, history_of, history_of_estimates
from clutch_results.prognosis.population import (
    Ageing,
    Common,
    Monthly,
    PeerGroup,
    Peers,
    Population,
    Usual,
    common_of,
    learn,
    monthly,
    population_from,
    population_record,
    without,
)
from clutch_results.prognosis.prognosis import Outlook, Prognosis, forecast, prognose
from clutch_results.prognosis.trend import Passage

__all__ = [
    "Ageing",
    "ChannelName",
    "Common",
    "History",
    "Monthly",
    "Outlook",
    "Passage",
    "PeerGroup",
    "Peers",
    "Population",
    "Prognosis",
    "Usual",
    "ageings",
    "common_of",
    "forecast",
    "history_of",
    "history_of_estimates",
    "learn",
    "monthly",
    "population_from",
    "population_record",
    "prognose",
    "without",
]
