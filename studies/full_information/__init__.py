"""The full-information estimator against the Cramér-Rao bound, on drives and noise that nothing was tuned on."""
