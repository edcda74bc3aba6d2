"""Remove secrets from text. All text that people or the bus get to see goes through `redact`."""

from __future__ import annotations

import re
from urllib.parse import quote, unquote

HIDDEN = "***"
"""Stands in the text where a secret was."""
_SECRET_CHARACTERS_MIN = 4
"""Shorter passwords are hidden in their URL only: to hide every 'a' would make messages unreadable.
"""

# Each pattern takes a few steps a character at most, as text of the bus is untrusted.
_WORD = re.compile(r"\S+")
_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]{0,30}://")
_PASSWORD = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*://[^/]*:.*@")
_PARAMETER = re.compile(
    r"(?i)((?<![a-z0-9])(?:user(?:name)?|pass(?:word|wd)?|pwd|auth|token|secret|api_?key"
    r"|sig(?:nature)?)"
    r"|private_key\w{0,30})=[^&\s]+"
)
_PATH = re.compile(
    r"(?<![A-Za-z])(?!file:)([A-Za-z][A-Za-z0-9+.-]{0,30}://[^\s/?#\"'<>]*)([/?#][^\s\"'<>]*)"
)
"""Scheme and host of a URL, and the rest of it; not of ``file:`` URLs, whose path is no secret."""
_RUN = re.compile(r"[A-Za-z0-9_~%+-]+")
_TOKEN_CHARACTERS_MIN = 16
"""A shorter run of characters does not count as a token."""
_HEX = re.compile(r"(?=.*[0-9])(?=.*[A-Fa-f])[0-9A-Fa-f]+")
_PIECE = re.compile(r"[A-Z]?[a-z]+|[A-Z]+|[0-9]+")
_PIECE_CHARACTERS = 4
"""Average length of a piece, in characters, up to which a run may be a token.

Words and numbers have longer pieces; random tokens change between small letters, capital letters
and digits about every second character.
"""
_KEY = re.compile(r"-----BEGIN ([A-Z ]*PRIVATE KEY)-----.*?(-----END \1-----|\Z)", re.DOTALL)
_known: set[str] = set()
"""Secrets to hide wherever they appear."""


def remember(source: str) -> None:
    """Remember the secrets of a camera's source, so that they are hidden outside its URL too.

    They may hold any characters.
    """
    # Tokens in the path and in the query.
    for _, rest in _PATH.findall(_with_userinfo("", source)):
        _known.update(run for run in _RUN.findall(rest) if _is_token(run))

    # User name and password, as written and with percent-encoding undone or done.
    match = re.match(r"[A-Za-z][A-Za-z0-9+.-]*://(.*)@", source, re.DOTALL)
    if match is None:
        return
    userinfo = match.group(1)
    _known.update({f"{userinfo}@", f"{unquote(userinfo)}@"})
    password = userinfo.partition(":")[2]
    for form in (
        password,
        unquote(password),
        quote(password, safe=""),
        quote(unquote(password), safe=""),
    ):
        if len(form) >= _SECRET_CHARACTERS_MIN:
            _known.add(form)


def redact(text: str) -> str:
    """Return ``text`` without secrets.

    These are user names and passwords of URLs and of parameters, tokens in the paths of URLs,
    private keys, and remembered secrets.
    """
    text = _KEY.sub(HIDDEN, text)
    for secret in sorted(_known, key=len, reverse=True):
        instead = f"{HIDDEN}@" if secret.endswith("@") else HIDDEN
        # As a part of a longer word it is that word: with the password "secret", "secrets" stays.
        whole = rf"(?<![A-Za-z]){re.escape(secret)}(?![A-Za-z])" if secret.isalpha() else None
        text = re.sub(whole, instead, text) if whole else text.replace(secret, instead)
    return _without(_with_userinfo(f"{HIDDEN}@", text))


def holds_secret(source: str) -> bool:
    """Return True if a source is a URL with a password or a token.

    A user name alone is no secret.
    """
    bare = _with_userinfo("", source)
    return _PASSWORD.match(source) is not None or _without(bare) != bare


def _with_userinfo(instead: str, text: str) -> str:
    """Replace the user name and password of each URL by ``instead``.

    They reach up to the last @ of the word, as passwords may hold @, : and /. So the host may be
    replaced too, but never too little.
    """

    def replaced(word: re.Match[str]) -> str:
        at = word[0].rfind("@")
        scheme = _SCHEME.search(word[0], 0, max(at, 0))
        return (
            word[0] if scheme is None else f"{word[0][: scheme.end()]}{instead}{word[0][at + 1 :]}"
        )

    return _WORD.sub(replaced, text)


def _without(text: str) -> str:
    """Remove tokens behind the host of URLs, and secret parameters."""
    text = _PATH.sub(lambda url: url[1] + _RUN.sub(_hidden_token, url[2]), text)
    return _PARAMETER.sub(rf"\g<1>={HIDDEN}", text)


def _hidden_token(run: re.Match[str]) -> str:
    return HIDDEN if _is_token(run[0]) else run[0]


def _is_token(run: str) -> bool:
    """Return True if a run of characters looks random.

    A token of small letters only cannot be told from a word.
    """
    parts = re.findall(r"[A-Za-z0-9]+", run)
    joined = "".join(parts)
    if len(joined) < _TOKEN_CHARACTERS_MIN:
        return False

    # A number at the end of a word does not count: people number things so.
    changes = sum(
        len(_PIECE.findall(part.rstrip("0123456789"))) - 1 for part in parts if not part.isdigit()
    )
    return _HEX.fullmatch(joined) is not None or changes * _PIECE_CHARACTERS >= len(joined)
