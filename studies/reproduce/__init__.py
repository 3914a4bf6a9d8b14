"""SAE 2015-01-1146 reproduced: its tables, its pictures, and the bound that no estimator passes."""
