"""Prognosis: from the past results of one clutch to how far its fluid will go, with how sure that is."""

from diag_service.diagnosis.prognosis.channels import ChannelName
from diag_service.diagnosis.prognosis.fluid_lives import ageings
from diag_service.diagnosis.prognosis.history import History, history_of, history_of_estimates
from diag_service.diagnosis.prognosis.outliers import Standing, common_course, standings
from diag_service.diagnosis.prognosis.passage import Passage
from diag_service.diagnosis.prognosis.population import Ageing, Kind, Peers, Population, Usual, learn
from diag_service.diagnosis.prognosis.prognosis import Outlook, Prognosis, prognose

__all__ = [
    "Ageing",
    "ChannelName",
    "History",
    "Kind",
    "Outlook",
    "Passage",
    "Peers",
    "Population",
    "Prognosis",
    "Standing",
    "Usual",
    "ageings",
    "common_course",
    "history_of",
    "history_of_estimates",
    "learn",
    "prognose",
    "standings",
]
