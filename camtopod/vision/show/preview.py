"""Preview: an observer of the pipeline that draws what it sees into a file."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

from camtopod.vision.analysis import Analysis
from camtopod.vision.settings import VisionSettings
from camtopod.vision.show.overlay import Overlay, Words
from camtopod.vision.show.shown_file import ShowError, open_shown_file


class Preview:
    """Draws analysed frames into a file until it cannot be written any more."""

    def __init__(
        self,
        path: Path,
        camera: str,
        settings: VisionSettings,
        words: Words,
        on_failure: Callable[[str], None],
    ) -> None:
        """Make sure that the file can be written. Raises `ShowError` if not.

        on_failure: called once, with the reason, if the file cannot be written later on.
        """
        self._file = open_shown_file(path)
        self._overlay = Overlay(camera, settings, words)
        self._on_failure = on_failure
        self._latest: Analysis | None = None
        self._failed = False

    def __call__(self, analysis: Analysis) -> None:
        """Take in a frame, and draw it if the file wants it."""
        if self._failed:
            return
        self._overlay.remember(analysis)
        self._latest = analysis
        now = time.monotonic()
        try:
            if self._file.wants(analysis.t, now):
                self._file.write(analysis.t, now, self._overlay.draw(analysis))
        except ShowError as error:
            self._fail(error)

    def close(self) -> None:
        """Write the last picture and complete the file."""
        try:
            if self._latest is not None and not self._failed:
                self._file.finish(self._overlay.draw(self._latest))
            self._file.close()
        except ShowError as error:
            self._fail(error)

    def _fail(self, error: ShowError) -> None:
        """Stop drawing, and report the reason once."""
        if not self._failed:
            self._failed = True
            self._on_failure(str(error))
