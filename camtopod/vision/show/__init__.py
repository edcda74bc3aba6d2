"""What the grabber sees, drawn for people: a video, or one picture that is replaced now and then.

`overlay` draws boxes, paths, foreground, areas and events into the working picture; `shown_file`
writes the result to a file on this machine; `preview` joins the two and is the pipeline's observer.
"""

from __future__ import annotations

from camtopod.vision.show.overlay import Words
from camtopod.vision.show.preview import Preview
from camtopod.vision.show.shown_file import ShowError

__all__ = [
    "Preview",
    "ShowError",
    "Words",
]
