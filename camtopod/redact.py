"""The one place where secrets are taken out of text: what a person or the bus sees goes through
`redact`.
"""

from __future__ import annotations

import re
from urllib.parse import quote, unquote

HIDDEN = "***"
_SECRET_CHARACTERS_MIN = 4
"""A shorter password is hidden inside its URL only: hiding every 'a' would hide the message too."""

# None of these takes more than a few steps a character: what others say on the bus comes here, too.
_WORD = re.compile(r"\S+")
_SCHEME = re.compile(r"[A-Za-z][A-Za-z0-9+.-]{0,30}://")
_PASSWORD = re.compile(r"[A-Za-z][A-Za-z0-9+.-]*://[^/]*:.*@")
_PARAMETER = re.compile(
    r"(?i)((?<![a-z0-9])(?:user(?:name)?|pass(?:word|wd)?|pwd|auth|token|secret|api_?key|sig(?:nature)?)"
    r"|private_key\w{0,30})=[^&\s]+"
)
_PATH = re.compile(
    r"(?<![A-Za-z])(?!file:)([A-Za-z][A-Za-z0-9+.-]{0,30}://[^\s/?#\"'<>]*)([/?#][^\s\"'<>]*)"
)
"""A URL's scheme and host, and what follows them; a file's is no secret."""
_RUN = re.compile(r"[A-Za-z0-9_~%+-]+")
_TOKEN_CHARACTERS_MIN = 16
_HEX = re.compile(r"(?=.*[0-9])(?=.*[A-Fa-f])[0-9A-Fa-f]+")
_PIECE = re.compile(r"[A-Z]?[a-z]+|[A-Z]+|[0-9]+")
_PIECE_CHARACTERS = 4
"""Words and numbers are longer than this on average; what was drawn by lot changes between small
and capital letters and digits at every second character or so."""
_KEY = re.compile(r"-----BEGIN ([A-Z ]*PRIVATE KEY)-----.*?(-----END \1-----|\Z)", re.DOTALL)
_known: set[str] = set()


def remember(source: str) -> None:
    """Learn a source's secret, so that it is hidden outside its URL too, whatever characters are in
    it.
    """
    for _, rest in _PATH.findall(_with_userinfo("", source)):
        _known.update(run for run in _RUN.findall(rest) if _is_token(run))
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
    """``text`` without the user names and passwords of URLs, also as parameters, tokens in their
    paths, private keys, and remembered secrets.
    """
    text = _KEY.sub(HIDDEN, text)
    for secret in sorted(_known, key=len, reverse=True):
        text = text.replace(secret, f"{HIDDEN}@" if secret.endswith("@") else HIDDEN)
    return _without(_with_userinfo(f"{HIDDEN}@", text))


def holds_secret(source: str) -> bool:
    """Whether a source is a URL with a password or a token; a user's name alone is none."""
    bare = _with_userinfo("", source)
    return _PASSWORD.match(source) is not None or _without(bare) != bare


def _with_userinfo(instead: str, text: str) -> str:
    """Up to the last @ of the word: passwords may hold @, : and /. It may replace the host too,
    never too little.
    """

    def replaced(word: re.Match[str]) -> str:
        at = word[0].rfind("@")
        scheme = _SCHEME.search(word[0], 0, max(at, 0))
        return (
            word[0] if scheme is None else f"{word[0][: scheme.end()]}{instead}{word[0][at + 1 :]}"
        )

    return _WORD.sub(replaced, text)


def _without(text: str) -> str:
    """What follows a URL's host, and parameters, without secrets."""
    text = _PATH.sub(lambda url: url[1] + _RUN.sub(_hidden_token, url[2]), text)
    return _PARAMETER.sub(rf"\g<1>={HIDDEN}", text)


def _hidden_token(run: re.Match[str]) -> str:
    return HIDDEN if _is_token(run[0]) else run[0]


def _is_token(run: str) -> bool:
    """Whether this was drawn by lot, as far as one can see: of small letters only it looks like a
    word.
    """
    parts = re.findall(r"[A-Za-z0-9]+", run)
    joined = "".join(parts)
    if len(joined) < _TOKEN_CHARACTERS_MIN:
        return False
    # A number at the end of a word is how people number things.
    changes = sum(
        len(_PIECE.findall(part.rstrip("0123456789"))) - 1 for part in parts if not part.isdigit()
    )
    return _HEX.fullmatch(joined) is not None or changes * _PIECE_CHARACTERS >= len(joined)
