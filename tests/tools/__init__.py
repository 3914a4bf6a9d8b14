"""Commands for people: what attacks and wears down the programs for longer than a test may."""
