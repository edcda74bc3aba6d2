#!/bin/sh
# One would guess: an FFmpeg option in OPENCV_FFMPEG_CAPTURE_OPTIONS is added to those that OpenCV
# sets.
# What happens: it takes their place. Without the variable OpenCV asks an RTSP camera for TCP;
# with any option in it, such as a smaller probe for a quicker start, FFmpeg asks for UDP, where
# pictures break on a busy or wireless network, and firewalls let nothing through. Nothing says
# so.
# Version: opencv-python-headless==5.0.0.93. The camera is some lines of RTSP, which hear the
# Transport of SETUP and end the session there.
# Seen: no variable RTP/AVP/TCP; probesize;32768 RTP/AVP/UDP; rtsp_transport;tcp|probesize;32768
# RTP/AVP/TCP.
# camtopod: says rtsp_transport;tcp with all its options (camtopod/vision/source/capture.py).
set -eu
unset OPENCV_FFMPEG_CAPTURE_OPTIONS
export OPENCV_LOG_LEVEL=OFF OPENCV_FFMPEG_LOGLEVEL=-8
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
trap 'exit 1' INT TERM
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check \
  opencv-python-headless==5.0.0.93 numpy==2.4.6
cat > "$folder/run.py" <<'PYTHON'
import os
import socket
import sys
import threading

import cv2

SDP = (
    "v=0\r\no=- 0 0 IN IP4 127.0.0.1\r\ns=x\r\nc=IN IP4 0.0.0.0\r\nt=0 0\r\n"
    "m=video 0 RTP/AVP 96\r\na=rtpmap:96 H264/90000\r\na=control:v\r\n"
)


def answer(connection, transports):
    lines = connection.makefile("r", newline="")
    while method := lines.readline().partition(" ")[0].strip():
        head = {}
        while line := lines.readline().strip():
            name, _, value = line.partition(":")
            head[name.lower()] = value.strip()
        status, more, content = "200 OK", "", ""
        if method == "DESCRIBE":
            more, content = "Content-Type: application/sdp\r\n", SDP
        elif method == "SETUP":
            transports.append(head["transport"].partition(";")[0])
            status = "454 Session Not Found"
        size = f"Content-Length: {len(content)}\r\n"
        reply = f"RTSP/1.0 {status}\r\nCSeq: {head['cseq']}\r\n{more}{size}\r\n{content}"
        connection.sendall(reply.encode())


def transport_of(options):
    """Return the transport that OpenCV asks for with these options."""
    os.environ.pop("OPENCV_FFMPEG_CAPTURE_OPTIONS", None)
    if options:
        os.environ["OPENCV_FFMPEG_CAPTURE_OPTIONS"] = options
    transports = []
    with socket.create_server(("127.0.0.1", 0)) as listener:
        listener.settimeout(20)
        url = f"rtsp://127.0.0.1:{listener.getsockname()[1]}/live"
        timeout = [cv2.CAP_PROP_OPEN_TIMEOUT_MSEC, 10_000]
        opening = threading.Thread(target=cv2.VideoCapture, args=(url, cv2.CAP_FFMPEG, timeout))
        opening.start()
        connection, _ = listener.accept()
        with connection:
            connection.settimeout(20)
            answer(connection, transports)
        opening.join(20)
    return transports[0]


options = ("", "probesize;32768", "rtsp_transport;tcp|probesize;32768")
outcome = [transport_of(one) for one in options]
print(f"OpenCV {cv2.__version__}: {outcome}")
expectation = ["RTP/AVP/TCP", "RTP/AVP/UDP", "RTP/AVP/TCP"]
if outcome != expectation:
    sys.exit(f"changed: expected {expectation}; seen {outcome}")
PYTHON
cd "$folder"
timeout 100 venv/bin/python run.py
