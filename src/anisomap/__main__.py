"""Run the command line: ``python -m anisomap``."""

from anisomap.cli import main

main()
