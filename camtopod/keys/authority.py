"""The private authority of a site: its key signs the certificates of daemon, cameras and readers.

One folder holds everything: ``authority/``, whose key never leaves it, and for each certificate a
folder to be copied to where it is used. ``authority/issued.json`` is the ledger of all
certificates. zenoh has no revocation lists, so a name is never issued twice: a replacement gets a
new name, and the old name loses its rights.
"""

from __future__ import annotations

import datetime
import ipaddress
import re
import shutil
from collections.abc import Sequence
from pathlib import Path

import msgspec
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID
from msgspec import Struct

from camtopod.config import secret_files
from camtopod.keys.rules import Access, Certificate, Role
from camtopod.records import CAMERA_PATTERN

CA = "ca.pem"
"""File name of the authority's certificate."""
CERTIFICATE = "certificate.pem"
"""File name of a certificate."""
PRIVATE_KEY = "private.key"
"""File name of a certificate's key."""
ACCESS = "access.json"
"""File name of the access list."""
DAEMON = "daemon"
"""Name of the daemon in the ledger, and of its folder."""
LOCAL_HOSTS = ("localhost", "127.0.0.1", "::1")
"""Host names for which the daemon's certificate is always valid, too."""
_BACKDATE = datetime.timedelta(days=1)
"""Certificates begin this much before now, as the clock of a box may be slow."""
_HOST = re.compile(r"(?!-)[A-Za-z0-9-]{1,63}(\.[A-Za-z0-9-]{1,63})*\Z")


class KeysError(Exception):
    """The authority cannot do the request; ``str()`` gives the reason and the remedy."""


class Issued(Struct, frozen=True):
    """An entry of the ledger: a certificate that was issued, and whether it is still valid."""

    certificate: Certificate
    of: str
    """The camera or reader; `DAEMON` for the daemon."""
    valid: bool = True


class Ledger(Struct, frozen=True):
    """Contents of ``authority/issued.json``."""

    site: str
    issued: list[Issued]


class Authority:
    """The authority in a folder.

    Its methods raise `KeysError` and `OSError`.

    now: seconds since 1970.
    """

    def __init__(self, folder: Path, now: float) -> None:
        self.folder = folder
        self._now = now
        try:
            raw = (folder / "authority" / "issued.json").read_bytes()
        except FileNotFoundError:
            raise KeysError(
                f"there is no authority in {folder}: `camtopod keys init` makes one"
            ) from None
        try:
            self._ledger = msgspec.json.decode(raw, type=Ledger)
        except ValueError as error:
            raise KeysError(
                f"{folder / 'authority' / 'issued.json'} cannot be read: {error}"
            ) from None

    @classmethod
    def create(cls, folder: Path, site: str, now: float, days: int, replace: bool) -> Authority:
        """Make a new authority; refuse to replace an existing one unless ``replace``.

        If it is replaced, its certificates become worthless.
        """
        # Refuse a folder that is in use.
        secret = folder / "authority"
        if not secret.exists() and any(path.is_file() for path in folder.rglob("*")):
            raise KeysError(
                f"{folder} holds other files; name an empty or a new folder with --keys"
            )
        if (secret / "ca.key").exists() and not replace:
            raise KeysError(
                f"{secret} holds an authority already; --replace makes a new one, and then every"
                f" certificate of the old one has to be made and copied again"
            )

        # Start with empty folders.
        for old in ("camera", "reader", "daemon"):
            shutil.rmtree(folder / old, ignore_errors=True)
        folder.parent.mkdir(parents=True, exist_ok=True)
        for private in (folder, secret, folder / "camera", folder / "reader"):
            _make_folder(private)

        # Make the key, and a certificate that it signs itself.
        key = ec.generate_private_key(ec.SECP256R1())
        name = x509.Name(
            [
                x509.NameAttribute(NameOID.ORGANIZATION_NAME, site),
                x509.NameAttribute(NameOID.COMMON_NAME, "camtopod authority"),
            ]
        )
        builder = _builder(name, name, key.public_key(), now, days)
        builder = builder.add_extension(
            x509.BasicConstraints(ca=True, path_length=0), critical=True
        )
        builder = builder.add_extension(_usage(signs=True), critical=True)
        builder = builder.add_extension(
            x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False
        )

        # Write the key, the certificate and an empty ledger.
        secret_files.write(secret / "ca.key", _pem(key))
        secret_files.write(
            secret / CA, builder.sign(key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)
        )
        secret_files.write(secret / "issued.json", msgspec.json.encode(Ledger(site, [])))
        return cls(folder, now)

    @property
    def site(self) -> str:
        """The site of this authority."""
        return self._ledger.site

    @property
    def issued(self) -> list[Issued]:
        """All certificates ever issued, oldest first."""
        return list(self._ledger.issued)

    @property
    def access(self) -> Access:
        """The access list: all valid certificates."""
        return Access(
            self.site, [issued.certificate for issued in self._ledger.issued if issued.valid]
        )

    @property
    def hosts(self) -> list[str]:
        """Host names and addresses for which the daemon's certificate is valid."""
        try:
            raw = (self.folder / DAEMON / CERTIFICATE).read_bytes()
        except FileNotFoundError:
            return []
        extensions = x509.load_pem_x509_certificate(raw).extensions
        return [
            str(name.value)
            for name in extensions.get_extension_for_class(x509.SubjectAlternativeName).value
        ]

    def issue(
        self,
        role: Role,
        name: str,
        days: int,
        replace: bool = False,
        hosts: Sequence[str] = (),
        cameras: Sequence[str] = (),
    ) -> Path:
        """Make a key and a certificate; return their folder.

        replace: revoke the present certificate.
        hosts: host names and addresses of the daemon.
        cameras: cameras that the program called ``name`` publishes, if it is not a camera itself.

        Without hosts or cameras, those of the replaced certificate are used.
        """
        # Check the arguments.
        common_name = self.next_name(role, name, days, replace)
        check_hosts(hosts)
        check_cameras(cameras)

        # Sign and write the certificate.
        folder = self._folder(role, name)
        expires = self._sign(
            folder, common_name, days, (hosts or self.hosts) if role == "daemon" else None
        )

        # Replace the old certificate in the ledger.
        before = [
            one.certificate for one in self.issued if (one.certificate.role, one.of) == (role, name)
        ]
        several = list(cameras) or (before[-1].cameras if before else [])
        self._mark_revoked(role, name)
        camera = name if role == "camera" and not several else ""
        certificate = Certificate(common_name, role, expires, camera, several)
        self._keep([*self.issued, Issued(certificate, name)])
        return folder

    def next_name(self, role: Role, name: str, days: int, replace: bool) -> str:
        """Return the common name that `issue` would use; raise what it would raise."""
        check_name(role, name)

        # There may be one valid certificate a name.
        old = [
            issued for issued in self.issued if (issued.certificate.role, issued.of) == (role, name)
        ]
        if any(issued.valid for issued in old) and not replace:
            until = date_text(next(issued.certificate.expires for issued in old if issued.valid))
            raise KeysError(
                f"{role} {name} has a certificate (until {until}); --replace makes a new one and"
                f" revokes it"
            )

        # A replacement gets a new common name.
        common_name = name if role != "reader" else f"reader:{name}"
        if old:
            common_name += f"~{len(old) + 1}"
        if len(common_name) > 64:
            raise KeysError(
                f"{name!r} is too long for a certificate: {common_name!r} has over 64 characters"
            )

        # The certificate must end before that of the authority.
        ends = self._certificate().not_valid_after_utc
        if self._now + 86400.0 * days > ends.timestamp():
            raise KeysError(f"the authority itself ends on {ends:%Y-%m-%d}: give fewer --days")
        return common_name

    def revoke(self, role: Role, name: str) -> None:
        """Revoke the certificate of ``name``.

        It takes effect when the daemon has the new access list.
        """
        self.require_certificate(role, name)
        self._mark_revoked(role, name)

    def require_certificate(self, role: Role, name: str) -> None:
        """Raise `KeysError` if ``name`` has no certificate to `revoke`."""
        if not any(
            issued.valid and (issued.certificate.role, issued.of) == (role, name)
            for issued in self.issued
        ):
            raise KeysError(f"{role} {name} has no certificate; `camtopod keys list` shows who has")

    def _mark_revoked(self, role: Role, name: str) -> None:
        theirs = (role, name)
        self._keep(
            [
                msgspec.structs.replace(
                    one, valid=one.valid and (one.certificate.role, one.of) != theirs
                )
                for one in self.issued
            ]
        )

    def _certificate(self) -> x509.Certificate:
        return x509.load_pem_x509_certificate((self.folder / "authority" / CA).read_bytes())

    def _sign(
        self, folder: Path, common_name: str, days: int, server_hosts: Sequence[str] | None
    ) -> float:
        """Write a key, its certificate and the authority's into ``folder``; return when it expires.

        The expiry is in seconds since 1970. ``server_hosts``: hosts of a server; None for a client.
        """
        # Load the authority's key and make a new one.
        secret = (self.folder / "authority" / "ca.key").read_bytes()
        loaded = serialization.load_pem_private_key(secret, password=None)
        ca = self._certificate()
        assert isinstance(loaded, ec.EllipticCurvePrivateKey)
        key = ec.generate_private_key(ec.SECP256R1())

        # Describe what the certificate may be used for, and by which hosts.
        builder = _builder(_common_name(common_name), ca.subject, key.public_key(), self._now, days)
        uses = [ExtendedKeyUsageOID.CLIENT_AUTH]
        if server_hosts is not None:
            uses.append(ExtendedKeyUsageOID.SERVER_AUTH)
            hosts = dict.fromkeys([*server_hosts, *LOCAL_HOSTS])
            names = [
                x509.DNSName(h) if (a := _address(h)) is None else x509.IPAddress(a) for h in hosts
            ]
            builder = builder.add_extension(x509.SubjectAlternativeName(names), critical=False)
        builder = builder.add_extension(
            x509.BasicConstraints(ca=False, path_length=None), critical=True
        )
        builder = builder.add_extension(_usage(signs=False), critical=True)
        signer = x509.AuthorityKeyIdentifier.from_issuer_public_key(loaded.public_key())
        builder = builder.add_extension(signer, critical=False)
        builder = builder.add_extension(x509.ExtendedKeyUsage(uses), critical=False)

        # Sign it and write the files.
        made = builder.sign(loaded, hashes.SHA256())
        _make_folder(folder)
        secret_files.write(folder / PRIVATE_KEY, _pem(key))
        secret_files.write(folder / CERTIFICATE, made.public_bytes(serialization.Encoding.PEM))
        secret_files.write(folder / CA, ca.public_bytes(serialization.Encoding.PEM))
        return made.not_valid_after_utc.timestamp()

    def _folder(self, role: Role, name: str) -> Path:
        return self.folder / DAEMON if role == "daemon" else self.folder / role / name

    def _keep(self, issued: list[Issued]) -> None:
        self._ledger = Ledger(self.site, issued)
        encoded = msgspec.json.format(msgspec.json.encode(self._ledger), indent=1)
        secret_files.write(self.folder / "authority" / "issued.json", encoded)


def check_name(role: Role, name: str) -> None:
    """Raise `KeysError` for a name that is not possible on the bus."""
    if not re.match(CAMERA_PATTERN, name):
        raise KeysError(
            f"{name!r} cannot be a {role}'s name: 1 to 64 of the characters A-Z a-z 0-9 _ . -"
        )
    if (role == "camera" and name == DAEMON) or name in (".", ".."):
        raise KeysError(f"{name!r} is reserved; give the {role} another name")


def check_cameras(cameras: Sequence[str]) -> None:
    """Raise `KeysError` for a list of cameras that no certificate can have."""
    for camera in cameras:
        check_name("camera", camera)
    if len(set(cameras)) < len(cameras):
        raise KeysError("the same camera is given twice")


def check_hosts(hosts: Sequence[str]) -> None:
    """Raise `KeysError` for a host that no certificate can have."""
    for host in hosts:
        if not _HOST.match(host) and _address(host) is None:
            raise KeysError(f"{host!r} is neither a host name nor an address")


def date_text(seconds: float) -> str:
    """Return the date of a time (seconds since 1970), UTC."""
    return f"{datetime.datetime.fromtimestamp(seconds, datetime.UTC):%Y-%m-%d}"


def write_public(path: Path, text: str) -> None:
    """Write a file without secrets beside the keys; it too is readable by its owner alone."""
    secret_files.write(path, text.encode())


def _builder(
    subject: x509.Name, issuer: x509.Name, key: ec.EllipticCurvePublicKey, now: float, days: int
) -> x509.CertificateBuilder:
    start = datetime.datetime.fromtimestamp(now, datetime.UTC)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(start - _BACKDATE)
        .not_valid_after(start + datetime.timedelta(days=days))
    )


def _usage(signs: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=not signs,
        key_cert_sign=signs,
        crl_sign=signs,
        content_commitment=False,
        key_encipherment=False,
        data_encipherment=False,
        key_agreement=False,
        encipher_only=False,
        decipher_only=False,
    )


def _common_name(name: str) -> x509.Name:
    return x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])


def _pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def _address(host: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(host)
    except ValueError:
        return None


def _make_folder(folder: Path) -> None:
    """Make a folder for its owner alone, or make an existing one so."""
    folder.mkdir(mode=0o700, exist_ok=True)
    folder.chmod(0o700)
