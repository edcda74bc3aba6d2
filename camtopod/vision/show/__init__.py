"""What the grabber sees, drawn for people: a video, or one image that is replaced now and then.

`overlay` draws boxes, paths, foreground, areas and events into the working image, as an observer
of the pipeline; `shown_file` writes the result to a file on this machine. `decision_words` says why
a track became an event or not.
"""

from camtopod.vision.show.decision_words import decision_line as decision_line
from camtopod.vision.show.overlay import Preview as Preview
from camtopod.vision.show.shown_file import ShowError as ShowError
