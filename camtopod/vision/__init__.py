"""Computer vision: turns one camera's video into entry and exit events.

`grabber` is the entry point: it reads a `source`, passes frames through the `pipeline` and yields
events. Reading order:

- `settings`: all settings of a grabber, with units;
- `source`: files, streams and devices -> frames with capture times;
- `detect`: noise filter, background model, moving pixels -> blobs;
- `detector`: optional; counts the people in moving regions before the blobs are tracked;
- `track`: blobs -> tracks -> crossings of the edge of the view;
- `pipeline`: frames -> events, without source, clock or waiting; an observer sees each analysis;
- `show`: draws that, as a video or a picture.

`boxes` has the geometry that they share.
"""
