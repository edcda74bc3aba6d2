"""What the grabber raises."""

from __future__ import annotations


class SourceError(OSError):
    """A video file that is there but cannot be decoded (or holds no frame). ``str()`` says which,
    without a password."""
