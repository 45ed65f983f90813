"""The command line, with one module per command."""

from anisomap.cli.app import main as main
