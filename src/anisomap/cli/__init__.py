"""The command line: sees everything, and nothing sees it. One file a command."""

from anisomap.cli.app import main as main
