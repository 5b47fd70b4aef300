"""Tokens by which programs log in: made here, known by their digest alone.  No I/O.

Rule 1: a token is 256 random bits.  Nobody guesses it, so its SHA-256 needs neither salt nor the slowness of a
        password's hash (passwords.py), and attempts need no rate limit.
Rule 2: a token acts for one user, with a role of its own that is at most the user's.  It ends with the user.
"""

from __future__ import annotations

import hashlib
import re
import secrets

PREFIX = "b51_"  # scanners for leaked secrets can tell what it is
_DIGEST = re.compile(r"[0-9a-f]{64}")


def new_token() -> str:
    """Return a new token; only its digest is to be kept."""
    return PREFIX + secrets.token_urlsafe(32)


def digest_of(token: str) -> str:
    """Return the digest under which a token is kept."""
    return hashlib.sha256(token.encode(errors="surrogatepass")).hexdigest()


def is_digest(text: str) -> bool:
    """Return whether `text` can be a digest."""
    return _DIGEST.fullmatch(text) is not None
