"""The full-information estimator, piece by piece."""
