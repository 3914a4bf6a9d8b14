"""Live buses: received without waiting, supervised, in bus time."""
