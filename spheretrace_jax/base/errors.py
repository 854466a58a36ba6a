"""Errors that a user can cause: one line that says what is wrong, where, and what was expected."""


class InputError(ValueError):
    """An argument, file or option that cannot be used. The command line exits with status 2."""


class SceneError(InputError):
    """A scene file that cannot be read or a scene that cannot be written."""


class PictureError(InputError):
    """A picture that cannot be read, written or used."""


class SceneWarning(UserWarning):
    """A usable scene that breaks a rule or cannot give the result asked of the scene."""


class PictureWarning(UserWarning):
    """A usable picture that may mean something else than what was read, or takes much memory."""


def printable(text: str) -> str:
    """Escapes text quoted from a file: one line, without control over the terminal."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)
