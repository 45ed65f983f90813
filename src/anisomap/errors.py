"""What can go wrong, in words that a user can act on.

Every message names what was wrong, where (file, line, sensor or frame) and what would be right.
"""


class AnisomapError(Exception):
    """Base of every error that anisomap raises on purpose; its message is one clear sentence."""


class InputError(AnisomapError, ValueError):
    """Data or an argument that cannot be used as given."""


class FileError(InputError):
    """A file that is missing, damaged, or not of the kind that it claims to be."""


class MissingExtraError(AnisomapError, ImportError):
    """An optional dependency that the call needs is not installed.

    Parameters
    ----------
    purpose : str
        What needs it, to begin the message with: ``"simulating a recording"``.
    extra : str
        Name of the extra that brings it: ``"simulation"``.
    """

    def __init__(self, purpose: str, extra: str) -> None:
        super().__init__(f"{purpose} needs an extra: pip install 'anisomap[{extra}]'")
        self.extra = extra


class AnisomapWarning(UserWarning):
    """The result stands, but weaker than it looks: the message says why."""
