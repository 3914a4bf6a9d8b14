"""What makes life hard for those who make a lake: a store that refuses and stalls, a log that takes all memory."""
