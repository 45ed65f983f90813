"""Help on one screen, and in full."""

import pytest

from anisomap.cli.app import BAD_INPUT, COMMANDS, app
from command_line import call

MAX_OPTIONS = 132
"""Options of all commands together."""


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_the_help_of_a_command_fits_a_screen_and_names_all_options(tmp_path, command):
    shown = call(tmp_path, command, "--help", width=80).out
    lines = shown.splitlines()
    assert len(lines) <= 24
    assert max(map(len, lines)) <= 80
    if not command:
        assert all(name in shown for name in COMMANDS)
        return
    assert shown.count("  anisomap ") == 3
    names = [one.name for one in options_of(command)]
    assert not [name for name in names if name not in shown.replace("--no-", "--")]


@pytest.mark.parametrize("command", sorted({*COMMANDS} - {"live", "paper", "demo"}))
def test_a_missing_argument_is_called_as_the_help_calls_it(tmp_path, command):
    name = call(tmp_path, command, code=BAD_INPUT).err.split()[1]
    assert name in call(tmp_path, command, "--help").out.partition("\n")[0].split()


def options_of(command):
    found = app[command].assemble_argument_collection(parse_docstring=True)
    return [one for one in found if one.show and one.name.startswith("--")]


def test_options_have_help_texts_and_are_not_too_many():
    every = [(command, one) for command in COMMANDS for one in options_of(command)]
    assert not [(command, one.name) for command, one in every if not one.parameter.help]
    assert len(every) <= MAX_OPTIONS


def test_all_of_the_help_is_shown_on_request(tmp_path):
    said = "The exit code is 0 if no difference is found, and 1 otherwise."
    for flag, full in (("--help-all", True), ("--help", False)):
        assert (said in " ".join(call(tmp_path, "diff", flag).out.split())) == full
    assert "Size of the readings in MiB" in call(tmp_path, "map --help-all").out
