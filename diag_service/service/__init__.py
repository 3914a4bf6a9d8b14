"""A live bus or a log through all stages, and what onlookers see of it."""
