"""What the grabber sees, drawn for people: a video, or one picture that is replaced now and then.

`overlay` draws boxes, paths, foreground, areas and events into the working picture; `shown_file`
writes the result to a file on this machine; `preview` joins the two and is the pipeline's observer.
"""

from camtopod.vision.show.overlay import Words as Words
from camtopod.vision.show.preview import Preview as Preview
from camtopod.vision.show.shown_file import ShowError as ShowError
