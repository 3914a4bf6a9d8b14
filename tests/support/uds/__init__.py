"""Clients of other makers, cars and controllers that tests ask, right and wrong ones."""
