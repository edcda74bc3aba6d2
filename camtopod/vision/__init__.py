"""Pixels -> events: capture, noise reduction, motion, tracks, crossings of the border of the view."""
