"""Answer a server that asks for an HTTP digest (RFC 7616; RFC 2069 where it offers no ``qop``)."""

from __future__ import annotations

import hashlib
import re
import secrets
from collections.abc import Iterable

from msgspec import Struct

_PARAMETER = re.compile(
    r"""(?:([\w-]+)[ \t]+)?  # a scheme, before its first parameter
    ([\w-]+)[ \t]*=[ \t]*(?:"((?:[^"\\]|\\.)*)"|([^\s,"]+))""",
    re.VERBOSE,
)
_SCHEME_ALONE = re.compile(r"\s*([\w-]+)\s*")
_HASHES = {"MD5": hashlib.md5, "SHA-256": hashlib.sha256}
"""Hash functions by name, the strongest last."""
_SESSION = "-SESS"
"""End of the name of an algorithm that hashes the nonces into the password's digest, too."""


class Challenge(Struct):
    """What a server asks for; texts are as they stand between the quotes."""

    scheme: str
    """``Digest``, or another one, such as ``Basic``."""
    realm: str = ""
    nonce: str = ""
    algorithm: str = ""
    """"" is MD5."""
    opaque: str = ""
    qop: str = ""
    """Kinds of protection, separated by commas; "" if the server knows none."""
    stale: str = ""
    count: int = 0
    """How often it was answered, which the server counts, too."""

    @property
    def is_stale(self) -> bool:
        """True if the nonce of the last answer was too old, not the password wrong."""
        return self.stale.lower() == "true"

    @property
    def name(self) -> str:
        """Name for people: the scheme, that of a digest with algorithm and protection."""
        if self.scheme.lower() != "digest":
            return self.scheme
        return " ".join(filter(None, [self.scheme, self.algorithm, self.qop]))

    @property
    def strength(self) -> int:
        """Strength of the algorithm, from 0 on; -1 if the challenge cannot be answered."""
        if self.scheme.lower() != "digest" or not self.nonce or self._hash_name not in _HASHES:
            return -1
        if self.qop and "auth" not in re.split(r"[\s,]+", self.qop.lower()):
            return -1
        return [*_HASHES].index(self._hash_name)

    @property
    def _hash_name(self) -> str:
        return (self.algorithm.upper() or "MD5").removesuffix(_SESSION)

    def authorization(self, user: str, password: str, method: str, path: str) -> str:
        """Return the value of the header ``Authorization`` of the next request."""
        is_session = self.algorithm.upper().endswith(_SESSION)
        function = _HASHES[self._hash_name]

        def digest(*texts: str) -> str:
            return function(":".join(texts).encode()).hexdigest()

        # Compute the response.
        self.count += 1
        count, client_nonce = f"{self.count:08x}", secrets.token_hex(16)
        secret = digest(user, self.realm, password)
        if is_session:
            secret = digest(secret, self.nonce, client_nonce)
        protection = [count, client_nonce, "auth"] if self.qop else []
        response = digest(secret, self.nonce, *protection, digest(method, path))

        # Write it, with the fields that the server needs.
        quoted_user = re.sub(r'(["\\])', r"\\\1", user)
        fields = [
            f'username="{quoted_user}", realm="{self.realm}", nonce="{self.nonce}", uri="{path}"',
            f'response="{response}"',
        ]
        if self.algorithm:
            fields.append(f"algorithm={self.algorithm}")
        if self.opaque:
            fields.append(f'opaque="{self.opaque}"')
        if self.qop or is_session:
            fields.append(f'cnonce="{client_nonce}"')
        if self.qop:
            fields.append(f"qop=auth, nc={count}")
        return f"Digest {', '.join(fields)}"


def challenges(values: Iterable[str]) -> list[Challenge]:
    """Return the challenges of the headers ``WWW-Authenticate``, the strongest first.

    values: as of `http.client`, which takes all bytes for Latin-1; they are taken for UTF-8.
    """
    result: list[Challenge] = []
    for value in values:
        text = value.encode("latin-1", "replace").decode(errors="replace")
        if match := _SCHEME_ALONE.fullmatch(text):
            result.append(Challenge(match[1]))
        for scheme, name, quoted, plain in _PARAMETER.findall(text):
            if scheme:
                result.append(Challenge(scheme))
            key = name.lower()
            if result and key in ("realm", "nonce", "algorithm", "opaque", "qop", "stale"):
                setattr(result[-1], key, quoted or plain)
    return sorted(result, key=lambda challenge: challenge.strength, reverse=True)
