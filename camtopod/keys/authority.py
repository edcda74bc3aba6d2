"""The private authority of a site: its key signs the certificates of daemon, cameras and readers.

It may be that of further sites, too, so that one certificate serves a camera that delivers to
several. The common names of their daemons and readers carry the site, as each site's access list
gives rights to names.

One folder holds everything: ``authority/``, whose key never leaves it, and for each certificate a
folder to be copied to where it is used; those of further sites are below ``site/NAME/``.
``authority/issued.json`` is the ledger of all certificates. zenoh has no revocation lists, so a
name is never issued twice: a replacement gets a new name, and the old name loses its rights.
"""

from __future__ import annotations

import datetime
import ipaddress
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
from camtopod.keys.rules import DAEMON, Access, Certificate, Role

CA = "ca.pem"
"""File name of the authority's certificate."""
CERTIFICATE = "certificate.pem"
"""File name of a certificate."""
PRIVATE_KEY = "private.key"
"""File name of a certificate's key."""
LOCAL_HOSTS = ("localhost", "127.0.0.1", "::1")
"""Host names for which the daemon's certificate is always valid, too."""
AUTHORITY_DAYS = 20 * 365
"""Validity of the authority; no certificate is valid for longer."""


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
        path = folder / "authority" / "issued.json"
        try:
            ledger = msgspec.json.decode(path.read_bytes(), type=Ledger)
        except FileNotFoundError:
            raise KeysError(
                f"there is no authority in {folder}: `camtopod keys init` makes one"
            ) from None
        except ValueError as error:
            raise KeysError(f"{path} cannot be read: {error}") from None
        self.site = ledger.site
        """The site of this authority."""
        self.entries = ledger.issued
        """All certificates ever issued, oldest first."""

    @classmethod
    def create(cls, folder: Path, site: str, now: float, replace: bool = False) -> Authority:
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
        for old in ("camera", "reader", "daemon", "site"):
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
        ends = _time(now) + datetime.timedelta(days=AUTHORITY_DAYS)
        builder = _builder(name, name, key, now, ends, signs=True).add_extension(
            x509.SubjectKeyIdentifier.from_public_key(key.public_key()), critical=False
        )
        certificate = builder.sign(key, hashes.SHA256())

        # Write the key, the certificate and an empty ledger.
        secret_files.write(secret / "ca.key", _pem(key))
        secret_files.write(secret / CA, certificate.public_bytes(serialization.Encoding.PEM))
        secret_files.write(secret / "issued.json", msgspec.json.encode(Ledger(site, [])))
        return cls(folder, now)

    @property
    def sites(self) -> list[str]:
        """The authority's own site, and those further ones whose daemon has had a certificate."""
        daemons = (entry.certificate for entry in self.entries if entry.of == DAEMON)
        return [*dict.fromkeys([self.site, *(site for daemon in daemons for site in daemon.sites)])]

    def home(self, site: str) -> Path:
        """Return the folder of a site's certificates, but for those of cameras."""
        return self.folder if site == self.site else self.folder / "site" / site

    def access(self, site: str | None = None) -> Access:
        """Return the access list of a site, the own one by default: its valid certificates."""
        site = site or self.site
        certificates = [
            entry.certificate
            for entry in self.entries
            if entry.valid and site in (entry.certificate.sites or [self.site])
        ]
        return Access(site, certificates)

    def hosts(self, site: str | None = None) -> list[str]:
        """Return the host names and addresses for which the daemon's certificate is valid."""
        raw = (self.home(site or self.site) / DAEMON / CERTIFICATE).read_bytes()
        extensions = x509.load_pem_x509_certificate(raw).extensions
        names = extensions.get_extension_for_class(x509.SubjectAlternativeName)
        return [str(name.value) for name in names.value]

    def issue(
        self,
        role: Role,
        name: str,
        days: int,
        replace: bool = False,
        hosts: Sequence[str] = (),
        cameras: Sequence[str] = (),
        sites: Sequence[str] = (),
    ) -> Path:
        """Make a key and a certificate; return their folder.

        replace: revoke the present certificate.
        hosts: host names and addresses of the daemon.
        cameras: cameras that the program called ``name`` publishes, if it is not a camera itself.
        sites: the sites in which it has rights, the authority's by default; one if not of a camera.

        Without hosts, cameras or sites, those of the replaced certificate are used.
        """
        # There may be one valid certificate a name; a replacement gets a new common name.
        site = "" if role == "camera" or [*sites] == [self.site] else "".join(sites[:1])
        old = self._entries(role, name, site)
        if not replace and any(entry.valid for entry in old):
            raise KeysError(
                f"{role} {name} has a certificate; --replace makes a new one and revokes it"
            )
        common_name = f"reader:{name}" if role == "reader" else name
        common_name += f":{site}" if site else ""
        if old:
            common_name += f"~{len(old) + 1}"
            cameras = cameras or old[-1].certificate.cameras
            sites = sites or old[-1].certificate.sites
        if len(common_name) > 64:
            raise KeysError(
                f"{name!r} is too long for a certificate: {common_name!r} has over 64 characters"
            )

        # Sign and write the certificate.
        folder = self.home(site or self.site) / role / name
        if role == "daemon":
            folder = folder.parent
            hosts = [*(hosts or (self.hosts(site) if old else ())), *LOCAL_HOSTS]
        expires = self._sign(folder, common_name, days, hosts)

        # Replace the old certificate in the ledger.
        camera = name if role == "camera" and not cameras else ""
        sites = [] if [*sites] == [self.site] else list(sites)
        certificate = Certificate(common_name, role, expires, camera, list(cameras), sites)
        self._keep([*self._without(old), Issued(certificate, name)])
        return folder

    def revoke(self, role: Role, name: str, site: str = "") -> None:
        """Revoke the certificate of ``name``, also once more.

        site: the further site of a reader.

        It takes effect when the daemon has the new access list.
        """
        entries = self._entries(role, name, site)
        if not entries:
            raise KeysError(f"{role} {name} has no certificate; `camtopod keys list` shows who has")
        self._keep(self._without(entries))

    def _entries(self, role: Role, name: str, site: str) -> list[Issued]:
        """Return the entries of a name; of a daemon or a reader, those of this further site."""
        return [
            entry
            for entry in self.entries
            if (entry.certificate.role, entry.of) == (role, name)
            and (role == "camera" or entry.certificate.sites == ([site] if site else []))
        ]

    def _without(self, entries: list[Issued]) -> list[Issued]:
        """Return the ledger's entries, those of ``entries`` no longer valid."""
        return [
            msgspec.structs.replace(entry, valid=entry.valid and entry not in entries)
            for entry in self.entries
        ]

    def _sign(self, folder: Path, common_name: str, days: int, hosts: Sequence[str]) -> float:
        """Write a key, its certificate and the authority's into ``folder``; return when it expires.

        The expiry is in seconds since 1970, and not after the authority's.

        hosts: host names and addresses of a server; none for a client.
        """
        # Load the authority's key and make a new one.
        secret = self.folder / "authority"
        authority_key = serialization.load_pem_private_key(
            (secret / "ca.key").read_bytes(), password=None
        )
        assert isinstance(authority_key, ec.EllipticCurvePrivateKey)
        authority = x509.load_pem_x509_certificate((secret / CA).read_bytes())
        key = ec.generate_private_key(ec.SECP256R1())

        # Describe what the certificate may be used for, and by which hosts.
        subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, common_name)])
        ends = min(_time(self._now) + datetime.timedelta(days), authority.not_valid_after_utc)
        builder = _builder(subject, authority.subject, key, self._now, ends, signs=False)
        uses = [ExtendedKeyUsageOID.CLIENT_AUTH]
        if hosts:
            uses.append(ExtendedKeyUsageOID.SERVER_AUTH)
            names = [_host_name(host) for host in dict.fromkeys(hosts)]
            builder = builder.add_extension(x509.SubjectAlternativeName(names), critical=False)
        signer = x509.AuthorityKeyIdentifier.from_issuer_public_key(authority_key.public_key())
        builder = builder.add_extension(signer, critical=False)
        builder = builder.add_extension(x509.ExtendedKeyUsage(uses), critical=False)

        # Sign it and write the files.
        certificate = builder.sign(authority_key, hashes.SHA256())
        _make_folder(folder)
        secret_files.write(folder / PRIVATE_KEY, _pem(key))
        secret_files.write(
            folder / CERTIFICATE, certificate.public_bytes(serialization.Encoding.PEM)
        )
        secret_files.write(folder / CA, authority.public_bytes(serialization.Encoding.PEM))
        return certificate.not_valid_after_utc.timestamp()

    def _keep(self, entries: list[Issued]) -> None:
        self.entries = entries
        data = msgspec.json.format(msgspec.json.encode(Ledger(self.site, entries)), indent=1)
        secret_files.write(self.folder / "authority" / "issued.json", data)


def date_text(seconds: float) -> str:
    """Return the date of a time (seconds since 1970), UTC."""
    return f"{_time(seconds):%Y-%m-%d}"


def _time(seconds: float) -> datetime.datetime:
    return datetime.datetime.fromtimestamp(seconds, datetime.UTC)


def _builder(
    subject: x509.Name,
    issuer: x509.Name,
    key: ec.EllipticCurvePrivateKey,
    now: float,
    ends: datetime.datetime,
    signs: bool,
) -> x509.CertificateBuilder:
    """Return a certificate to be signed: of an authority if it ``signs`` others, else of a program.

    It begins a day before ``now``, as the clock of a box may be slow.
    """
    usage = x509.KeyUsage(
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
    constraints = x509.BasicConstraints(ca=signs, path_length=0 if signs else None)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(_time(now - 86400.0))
        .not_valid_after(ends)
        .add_extension(constraints, critical=True)
        .add_extension(usage, critical=True)
    )


def _pem(key: ec.EllipticCurvePrivateKey) -> bytes:
    return key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    )


def _host_name(host: str) -> x509.GeneralName:
    """Return a host as certificates name it: by address or by name."""
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _make_folder(folder: Path) -> None:
    """Make a folder for its owner alone, with those around it, or make an existing one so."""
    if not folder.parent.exists():
        _make_folder(folder.parent)
    folder.mkdir(mode=0o700, exist_ok=True)
    folder.chmod(0o700)
