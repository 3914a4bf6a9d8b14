"""Power cuts in every part of the fleet at once, and the account of what is left."""
