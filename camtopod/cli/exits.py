"""Exit statuses of the command line, and errors that end a command with a message for its user."""

from __future__ import annotations

DONE = 0
FAILED = 1
USAGE = 2
INPUT = 66
BUS = 69
STATE = 74
CONFIG = 78


class CommandError(Exception):
    """Error that ends the command with ``status``; ``str()`` says what happened and what to do."""

    def __init__(self, message: str, status: int = FAILED) -> None:
        super().__init__(message)
        self.status = status


class InputError(CommandError):
    """Error for an input that cannot be read (status 66)."""

    def __init__(self, message: str) -> None:
        super().__init__(message, INPUT)
