"""The fleet's side: the results of all vehicles from a broker into one database, once each, and answers about them."""

__all__: list[str] = []
