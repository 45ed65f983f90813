"""How fast the stages are, beside what a user would pick instead: ``make bench``."""
