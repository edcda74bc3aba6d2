"""For other people's programs."""

from camtopod.adapt.tracks import TrackEvents

__all__ = ["TrackEvents"]
