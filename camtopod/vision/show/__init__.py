"""What the grabber sees, drawn for people: a video, or one picture that is replaced now and then.

`overlay` draws boxes, paths, foreground, areas and events into the working picture, as an observer
of the pipeline; `shown_file` writes the result to a file on this machine.
"""

from camtopod.vision.show.overlay import Preview as Preview, Words as Words
from camtopod.vision.show.shown_file import ShowError as ShowError
