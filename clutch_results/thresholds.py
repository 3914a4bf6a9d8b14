"""Where a verdict changes: ratios of what new fluid has."""

CHANGE_LEVEL_RATIO = 0.80  # torque reserve of the hold pressure (1.5) is half used up; of new, and of the own baseline
WATCH_LEVEL_RATIO = 0.90
WATCH_MARGIN_RATIO = 0.50  # half of the new fluid's margin against shudder is gone
