"""Errors that a user can cause: one line that says what is wrong, where, and what was expected."""


class InputError(ValueError):
    """Something that the user gave cannot be used. The command line exits with status 2."""


class SceneError(InputError):
    """A scene file that cannot be read or a scene that cannot be written."""


class PictureError(InputError):
    """A picture that cannot be read, written or used."""


class SceneWarning(UserWarning):
    """A scene that can be used but breaks a rule, or cannot give what is asked of it."""


def printable(text: str) -> str:
    """What is quoted from a file, on one line and with no power over the terminal."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)
