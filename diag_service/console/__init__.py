"""What people read: notices, progress, lines that fit a terminal."""
