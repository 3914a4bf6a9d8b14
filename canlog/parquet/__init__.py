"""Parquet files written from codes: what repeats is written once, what is not there costs nothing."""
