"""The certificates of a site, some of them faulty."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Any

import msgspec

from camtopod.config.settings import BusSettings, TlsSettings
from camtopod.keys import rules
from camtopod.keys.authority import Authority


class Keys:
    """The authority of the site ``hq``, and certificates; ``gone`` was withdrawn.

    In ``other`` is another authority's of cam1, in ``old`` one that has expired.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        now = time.time()
        self.authority = Authority.create(folder, "hq", now)
        self.authority.issue("daemon", "daemon", 100)
        self.authority.issue("reader", "wall", 100)
        for camera in ("cam1", "cam2", "gone"):
            self.authority.issue("camera", camera, 100)
        self.authority.revoke("camera", "gone")
        self.allow(folder / "daemon" / "access.json")
        other = Authority.create(folder / "other", "hq", now)
        other.issue("camera", "cam1", 100)
        Authority.create(folder / "old", "hq", now)
        for name in ("ca.key", "ca.pem"):
            old = folder / "old/authority" / name
            old.write_bytes((folder / "authority" / name).read_bytes())
        Authority(folder / "old", now - 50 * 86400.0).issue("camera", "cam1", 20)

    def tls(self, own: str) -> dict[str, Any]:
        """Return zenoh's settings for the certificate in the folder ``own``."""
        folder = self.folder / own
        return rules.mutual_tls(
            str(self.folder / "authority" / "ca.pem"),
            str(folder / "certificate.pem"),
            str(folder / "private.key"),
        )

    def bus(
        self, own: str, endpoint: str = "", listen: str = "", patience: float = 3.0
    ) -> BusSettings:
        """Return the settings of a program that has this certificate."""
        folder = self.folder / own
        files = [str(folder / name) for name in ("ca.pem", "certificate.pem", "private.key")]
        return BusSettings(
            connect=(endpoint,) if endpoint else (),
            listen=(listen,) if listen else (),
            tls=TlsSettings(*files, access=str(self.folder / "daemon" / "access.json")),
            connect_seconds=patience,
        )

    def allow(self, path: Path, everything: str = "") -> Path:
        """Write an access list; the certificate named ``everything`` may do what the daemon may."""
        certificates = [
            msgspec.structs.replace(c, role="daemon") if c.name == everything else c
            for c in self.authority.access().certificates
        ]
        path.write_bytes(msgspec.json.encode(rules.Access("hq", certificates)))
        return path
