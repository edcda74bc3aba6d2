"""Other programs' output -> entry and exit events. One module a format; no I/O, no clock, no threads.

`tracks.TrackEvents` is what they share: tracks, frame by frame, in; events out.
"""
