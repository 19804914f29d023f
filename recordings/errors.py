"""The one error that every reader here raises."""

from collections.abc import Iterator
from contextlib import contextmanager


class InputError(ValueError):
    """A file or recording that cannot be used: one line with what was expected, what came, and the fix."""


@contextmanager
def about(subject: object) -> Iterator[None]:
    """Put `subject` (a file's path) in front of the message of an InputError that passes, once.

    Names out of a file may hold line breaks and a terminal's commands: each becomes a blank.
    """
    try:
        yield
    except InputError as error:
        message = str(error).removeprefix(f"{subject}: ")
        if message.isprintable() and message != str(error):
            raise
        raise InputError(f"{subject}: {_printable(message)}") from error.__cause__


@contextmanager
def readable(subject: object, what: str) -> Iterator[None]:
    """Turn any exception of a third-party reader into an InputError: a broken file fails anywhere inside.

    `subject` is the file's path, `what` it should be: "an MCAP file".
    """
    try:
        with about(subject):
            yield
    except InputError:
        raise
    except Exception as error:
        raise InputError(
            f"{subject}: expected {what} that can be read ({_printable(first_line(error)):.300})"
        ) from error


def _printable(message: str) -> str:
    return "".join(letter if letter.isprintable() else " " for letter in message)


def first_line(error: BaseException) -> str:
    """The first line of an error's message, or its kind when it has none."""
    return next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)
