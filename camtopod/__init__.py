"""camtopod: learns how the cameras of a site hang together, from anonymous entry and exit events
alone.
"""

__version__ = "0.1.0"
