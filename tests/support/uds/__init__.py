"""A second implementation of the diagnosis, from the standard's prose, and random clients for both."""
