"""The private authority of a site: one key signs the certificates of its daemon, cameras and
readers.

A folder holds everything: ``authority/`` (whose key never leaves it), and for each certificate a
folder that is copied to where it is used. Who was given what stands in ``authority/issued.json``.
zenoh knows no revocation lists, so a name is never given out twice: a replaced certificate has a
new name, and the old one no rights.
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
CERTIFICATE = "certificate.pem"
PRIVATE_KEY = "private.key"
ACCESS = "access.json"
DAEMON = "daemon"
LOCAL_HOSTS = ("localhost", "127.0.0.1", "::1")
"""The daemon's certificate is good for these, too."""
_BACKDATE = datetime.timedelta(days=1)
"""Certificates begin this much earlier: the clock of a box may be behind."""
_COMMON_NAME_MAX = 64
_HOST = re.compile(r"(?!-)[A-Za-z0-9-]{1,63}(\.[A-Za-z0-9-]{1,63})*\Z")


class KeysError(Exception):
    """The authority cannot do that; ``str()`` says why and what to do."""


class Issued(Struct, frozen=True):
    """A line of the ledger: a certificate that was given out, and whether it still counts."""

    certificate: Certificate
    of: str
    """The camera or reader; `DAEMON` for the daemon."""
    valid: bool = True


class Ledger(Struct, frozen=True):
    """``authority/issued.json``."""

    site: str
    issued: list[Issued]


class Authority:
    """The authority in a folder. ``now``: seconds since 1970. Raises `KeysError`, `OSError`."""

    def __init__(self, folder: Path, now: float) -> None:
        self.folder, self._now = folder, now
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
    def make(cls, folder: Path, site: str, now: float, days: int, replace: bool) -> Authority:
        """A new authority. One that is there already stays unless ``replace``, and is then worth
        nothing.
        """
        secret = folder / "authority"
        if not secret.exists() and any(path.is_file() for path in folder.rglob("*")):
            raise KeysError(
                f"{folder} holds other files; name an empty folder, or none yet, with --keys"
            )
        if (secret / "ca.key").exists() and not replace:
            raise KeysError(
                f"{secret} holds an authority already; --replace makes a new one, and then every certificate "
                f"of the old one has to be made and copied again"
            )
        for old in ("camera", "reader", "daemon"):
            shutil.rmtree(folder / old, ignore_errors=True)
        folder.parent.mkdir(parents=True, exist_ok=True)
        for private in (folder, secret, folder / "camera", folder / "reader"):
            _make_folder(private)
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
        secret_files.write(secret / "ca.key", _pem(key))
        secret_files.write(
            secret / CA, builder.sign(key, hashes.SHA256()).public_bytes(serialization.Encoding.PEM)
        )
        secret_files.write(secret / "issued.json", msgspec.json.encode(Ledger(site, [])))
        return cls(folder, now)

    @property
    def site(self) -> str:
        """Whose authority this is."""
        return self._ledger.site

    @property
    def issued(self) -> list[Issued]:
        """Everything ever given out, oldest first."""
        return list(self._ledger.issued)

    @property
    def access(self) -> Access:
        """The certificates that count."""
        return Access(
            self.site, [issued.certificate for issued in self._ledger.issued if issued.valid]
        )

    @property
    def hosts(self) -> list[str]:
        """The names and addresses for which the daemon's certificate is good."""
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
        """A key and a certificate; returns their folder. ``replace`` withdraws the one that is
        there.

        ``hosts``: of the daemon; ``cameras``: for whom a program called ``name`` speaks, not being
        a camera itself. None given: those of the certificate that is replaced.
        """
        common_name = self.next_name(role, name, days, replace)
        check_hosts(hosts)
        check_cameras(cameras)
        folder = self._folder(role, name)
        expires = self._sign(
            folder, common_name, days, (hosts or self.hosts) if role == "daemon" else None
        )
        before = [
            one.certificate for one in self.issued if (one.certificate.role, one.of) == (role, name)
        ]
        several = list(cameras) or (before[-1].cameras if before else [])
        self._withdraw(role, name)
        camera = name if role == "camera" and not several else ""
        certificate = Certificate(common_name, role, expires, camera, several)
        self._keep([*self.issued, Issued(certificate, name)])
        return folder

    def next_name(self, role: Role, name: str, days: int, replace: bool) -> str:
        """What would stand in the certificate that `issue` makes; raises what it would raise."""
        check_name(role, name)
        old = [
            issued for issued in self.issued if (issued.certificate.role, issued.of) == (role, name)
        ]
        if any(issued.valid for issued in old) and not replace:
            until = day(next(issued.certificate.expires for issued in old if issued.valid))
            raise KeysError(
                f"{role} {name} has a certificate (until {until}); --replace makes a new one and withdraws it"
            )
        common_name = name if role != "reader" else f"reader:{name}"
        if old:
            common_name += f"~{len(old) + 1}"
        if len(common_name) > _COMMON_NAME_MAX:
            raise KeysError(
                f"{name!r} is too long for a certificate: {common_name!r} has over {_COMMON_NAME_MAX} characters"
            )
        ends = self._certificate().not_valid_after_utc
        if self._now + 86400.0 * days > ends.timestamp():
            raise KeysError(f"the authority itself ends on {ends:%Y-%m-%d}: give fewer --days")
        return common_name

    def revoke(self, role: Role, name: str) -> None:
        """What ``name`` was given counts no longer, as soon as the daemon has the new access
        list.
        """
        self.must_have(role, name)
        self._withdraw(role, name)

    def must_have(self, role: Role, name: str) -> None:
        """Raises `KeysError` if there is nothing to `revoke`."""
        if not any(
            issued.valid and (issued.certificate.role, issued.of) == (role, name)
            for issued in self.issued
        ):
            raise KeysError(f"{role} {name} has no certificate; `camtopod keys list` shows who has")

    def _withdraw(self, role: Role, name: str) -> None:
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
        """Write key, certificate and the authority's certificate into ``folder``; returns when it
        expires.
        """
        secret = (self.folder / "authority" / "ca.key").read_bytes()
        loaded = serialization.load_pem_private_key(secret, password=None)
        ca = self._certificate()
        assert isinstance(loaded, ec.EllipticCurvePrivateKey)
        key = ec.generate_private_key(ec.SECP256R1())
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
    """Raises `KeysError` for a name that the bus cannot have."""
    if not re.match(CAMERA_PATTERN, name):
        raise KeysError(
            f"{name!r} cannot be a {role}'s name: 1 to 64 of the characters A-Z a-z 0-9 _ . -"
        )
    if (role == "camera" and name == DAEMON) or name in (".", ".."):
        raise KeysError(f"{name!r} is taken; call the {role} otherwise")


def check_cameras(cameras: Sequence[str]) -> None:
    """Raises `KeysError` for what no certificate can speak for."""
    for camera in cameras:
        check_name("camera", camera)
    if len(set(cameras)) < len(cameras):
        raise KeysError("the same camera is given twice")


def check_hosts(hosts: Sequence[str]) -> None:
    """Raises `KeysError` for what no certificate can be good for."""
    for host in hosts:
        if not _HOST.match(host) and _address(host) is None:
            raise KeysError(f"{host!r} is neither a host's name nor an address")


def day(seconds: float) -> str:
    """The date of a time, UTC."""
    return f"{datetime.datetime.fromtimestamp(seconds, datetime.UTC):%Y-%m-%d}"


def write_public(path: Path, text: str) -> None:
    """A file without secrets beside the keys, for its owner alone all the same."""
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
    """For its owner alone, also if it was there before."""
    folder.mkdir(mode=0o700, exist_ok=True)
    folder.chmod(0o700)
