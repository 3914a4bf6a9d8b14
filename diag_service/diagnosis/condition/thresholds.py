"""Every threshold of the verdict; docs/verdict.md says why each has its value."""

MIN_SHIFT_COUNT = 3  # of two that disagree nobody knows which is wrong
MAX_MARGIN_STD_RATIO = 0.25  # of the reference margin: beyond it the slope is anyone's guess
SURE_MARGIN_STD_RATIO = 0.05  # likewise: until it is known so well, more shifts will tell a thin margin from a good one
CHANGE_LEVEL_RATIO = 0.80  # torque reserve of the hold pressure (1.5) is half used up; of new, and of the own baseline
WATCH_LEVEL_RATIO = 0.90
WATCH_MARGIN_RATIO = 0.50  # half of the new fluid's margin against shudder is gone
CHANGE_PROBABILITY = 0.95  # a workshop visit costs: be sure
WATCH_PROBABILITY = 0.80
THIN_PROBABILITY = 0.01  # of a thin margin, to call a fluid good before that: a drive is judged a hundred times
EARLY_MARGIN_STD_RATIO = 0.15  # worse known, the margin of one clutch is believed only as far as both together say so
COMMON_THIN_PROBABILITY = 0.003  # the same by both clutches together: they slip in one oil
LEAVE_PROBABILITY = 0.20  # to call off a verdict once given, its cause must have become unlikely
FIT_WINDOW = 20  # shifts of both clutches: two cycles
MAX_MISFIT_SHARE = 0.25  # none of the shifts of sound drives misfit; of another vehicle's calibration half do
MIN_MISFIT_COUNT = 3  # one or two shifts are no share
NEW_FLUID_CONTRADICTIONS = 6  # it contradicts what is known of each clutch up to three times, then that starts afresh
CALIBRATED_RATIO = 0.7  # of what driving tells of a vehicle: from there on it is no longer said to be calibrating
