"""Exceptions of video sources."""

from __future__ import annotations


class SourceError(OSError):
    """A video file exists but cannot be decoded, or holds no frame.

    ``str()`` names the file, without a password.
    """
