"""Testers on an IP network: the pure part without sockets, a second reading of the standard, foreign clients."""
