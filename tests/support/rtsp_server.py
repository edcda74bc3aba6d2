"""Serve an H.264 file over RTSP in real time; needs a Python with GStreamer's bindings.

    python3 rtsp_server.py FILE

Prints the port it listens on, then serves until it is killed. Each client gets the file from the
beginning. What sounds beside it, unheard, is live: so no duration is told, as of a camera.
"""

import sys

import gi

gi.require_version("Gst", "1.0")
gi.require_version("GstRtspServer", "1.0")
from gi.repository import GLib, Gst, GstRtspServer  # noqa: E402

Gst.init(None)
server = GstRtspServer.RTSPServer()
server.set_address("127.0.0.1")
server.set_service("0")
factory = GstRtspServer.RTSPMediaFactory()
factory.set_launch(
    f'( filesrc location="{sys.argv[1]}" ! qtdemux ! h264parse ! rtph264pay name=pay0 pt=96 config-interval=-1 '
    "audiotestsrc is-live=true ! fakesink )"
)
server.get_mount_points().add_factory("/camera", factory)
server.attach(None)
print(server.get_bound_port(), flush=True)
GLib.MainLoop().run()
