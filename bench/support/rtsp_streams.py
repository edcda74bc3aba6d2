"""Real streams for tests: an RTSP server, a fault proxy in front of it, and faulty hosts."""

from __future__ import annotations

import shutil
import socket
import subprocess
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import cache
from pathlib import Path

SYSTEM_PYTHON = "/usr/bin/python3"
"""Python that has the bindings of GStreamer."""
_PROBE = (
    "import gi; gi.require_version('GstRtspServer', '1.0'); from gi.repository import GstRtspServer"
)


@cache
def missing() -> str | None:
    """Return what is missing to serve RTSP here, as the reason of a skip; None if nothing is."""
    if shutil.which("ffmpeg") is None:
        return "no ffmpeg"
    if not Path(SYSTEM_PYTHON).exists():
        return f"no {SYSTEM_PYTHON}"
    probe = subprocess.run([SYSTEM_PYTHON, "-c", _PROBE], capture_output=True, check=False)
    return (
        None if probe.returncode == 0 else "no GStreamer RTSP server (gir1.2-gst-rtsp-server-1.0)"
    )


def transcode(source: Path, target: Path, fps: float, seconds: float | None = None) -> None:
    """Encode at most ``seconds`` of ``source`` as H.264 at ``fps`` frames/s, the same frames."""
    limit = [] if seconds is None else ["-t", str(seconds)]
    command = [
        "ffmpeg",
        "-nostdin",
        "-loglevel",
        "error",
        "-y",
        "-r",
        str(fps),
        "-i",
        str(source),
        *limit,
    ]
    command += [
        "-an",
        "-c:v",
        "libx264",
        "-preset",
        "veryfast",
        "-crf",
        "20",
        "-bf",
        "0",
        "-g",
        str(round(fps)),
    ]
    subprocess.run([*command, "-pix_fmt", "yuv420p", str(target)], check=True)


@contextmanager
def served(path: Path) -> Iterator[int]:
    """Serve an H.264 file at rtsp://127.0.0.1:PORT/camera; yield the port."""
    script = Path(__file__).parents[2] / "tests" / "support" / "rtsp_server.py"
    with subprocess.Popen(
        [SYSTEM_PYTHON, str(script), str(path)], stdout=subprocess.PIPE, text=True
    ) as process:
        assert process.stdout is not None
        try:
            yield int(process.stdout.readline())
        finally:
            process.kill()


class FaultProxy:
    """A TCP proxy to a port on this machine that can stall, cut and refuse connections."""

    def __init__(self, target_port: int) -> None:
        self._target = target_port
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = self._listener.getsockname()[1]
        self._pairs: list[tuple[socket.socket, socket.socket]] = []
        self._flowing = threading.Event()
        self._flowing.set()
        self._is_closed = False
        self.refusing = False
        self.connections = 0
        threading.Thread(target=self._accept, daemon=True).start()

    def stall(self) -> None:
        """Keep connections, but forward nothing."""
        self._flowing.clear()

    def resume(self) -> None:
        """Forward again."""
        self._flowing.set()

    def cut(self) -> None:
        """Close all connections."""
        pairs, self._pairs = self._pairs, []
        for pair in pairs:
            for side in pair:
                _shut(side)

    def close(self) -> None:
        """Stop the proxy."""
        self._is_closed = True
        _shut(self._listener)
        self.resume()
        self.cut()

    def _accept(self) -> None:
        while not self._is_closed:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            self.connections += 1
            if self.refusing:
                _shut(client)
                continue
            try:
                server = socket.create_connection(("127.0.0.1", self._target))
            except OSError:
                _shut(client)
                continue
            self._pairs.append((client, server))
            for a, b in ((client, server), (server, client)):
                threading.Thread(target=self._forward, args=(a, b), daemon=True).start()

    def _forward(self, source: socket.socket, target: socket.socket) -> None:
        try:
            while data := source.recv(65536):
                self._flowing.wait()
                target.sendall(data)
        except OSError:
            pass
        finally:
            _shut(source)
            _shut(target)


class Host:
    """A host that treats each connection by ``treat``, in a thread of its own."""

    def __init__(self, treat: Callable[[socket.socket], None]) -> None:
        self._treat = treat
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.url = f"rtsp://admin:p@ssw0rd@127.0.0.1:{self._listener.getsockname()[1]}/stream"
        self.connections = 0
        threading.Thread(target=self._accept, daemon=True).start()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                client, _ = self._listener.accept()
                self.connections += 1
                threading.Thread(target=self._one, args=(client,), daemon=True).start()

    def _one(self, client: socket.socket) -> None:
        with client, suppress(OSError):
            self._treat(client)

    def close(self) -> None:
        with suppress(OSError):
            self._listener.shutdown(socket.SHUT_RDWR)
        self._listener.close()


def silent(client: socket.socket) -> None:
    """Read everything and answer nothing."""
    while client.recv(65536):
        pass


def hang_up(client: socket.socket) -> None:
    """Close at once."""


def rtsp_answer(status: str) -> Callable[[socket.socket], None]:
    """Answer every DESCRIBE with ``status``."""

    def treat(client: socket.socket) -> None:
        while request := client.recv(65536).decode():
            reply_status = "200 OK" if request.startswith("OPTIONS") else status
            number = next(line for line in request.split("\r\n") if line.startswith("CSeq"))
            headers = (
                "Public: OPTIONS, DESCRIBE"
                if reply_status == "200 OK"
                else 'WWW-Authenticate: Digest realm="x", nonce="y"'
            )
            client.sendall(f"RTSP/1.0 {reply_status}\r\n{number}\r\n{headers}\r\n\r\n".encode())

    return treat


def _shut(side: socket.socket) -> None:
    with suppress(OSError):
        side.shutdown(socket.SHUT_RDWR)
    side.close()
