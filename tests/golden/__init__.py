"""A record of the results on fixed recordings, which shows what a change of the code changes."""
