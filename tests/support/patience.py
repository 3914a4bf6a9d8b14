"""How long a test waits for what must happen: no machine is so busy that it takes longer, only a hang does."""

HANG_S = 900.0
