"""Prognosis: from the past results of one clutch to how far its fluid will go, with how sure that is."""

from diag_service.diagnosis.prognosis.history import History, history_of
from diag_service.diagnosis.prognosis.passage import Passage
from diag_service.diagnosis.prognosis.prognosis import Outlook, Prognosis, prognose

__all__ = ["History", "Outlook", "Passage", "Prognosis", "history_of", "prognose"]
