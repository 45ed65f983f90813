"""The help of every command is complete."""

from anisomap.cli.app import app


def test_every_option_has_a_help_text():
    commands = [name for name in app if not name.startswith("-")]
    assert "map" in commands
    without = [
        (command, *argument.names)
        for command in commands
        for argument in app[command].assemble_argument_collection(parse_docstring=True)
        if argument.show and not argument.parameter.help
    ]
    assert not without
