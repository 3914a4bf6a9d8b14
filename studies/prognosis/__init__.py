"""How good prognoses are: simulated lives of clutches with their truth, scores, baselines."""
