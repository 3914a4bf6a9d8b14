"""Certificates for a fleet under test: an authority, a broker's certificate, and one per vehicle, made and renewed.

``fleet_backend.certificates.authority`` makes them; it needs the extra ``security``, so nothing here loads it.
"""
