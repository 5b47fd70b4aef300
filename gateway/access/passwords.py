"""Password hashes: scrypt with a salt (RFC 7914).

A hash is the line `scrypt$<n>$<r>$<p>$<salt>$<key>` with salt and key in hexadecimal.  It contains the costs, so that
they can be raised for new passwords while the old ones remain valid.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets

from protocol.errors import UsageError

_N, _R, _P = 2**14, 8, 1  # 16 MiB and about 50 ms for each attempt
_MAX_MEMORY = 64 * 2**20
SHORTEST = 8
LONGEST = 256  # characters; a much longer password is an attack
NOBODY = f"scrypt${_N}${_R}${_P}${'00' * 16}${'00' * 32}"  # matches no password, but takes as long as a real one


def hash_password(password: str) -> str:
    """The hash of a new password.

    Raises:
        UsageError: it is too short or too long.
    """
    if not SHORTEST <= len(password) <= LONGEST:
        problem = f"The password has {len(password)} characters"
        raise UsageError(problem, remedy=f"Choose {SHORTEST} to {LONGEST} characters")
    salt = secrets.token_bytes(16)
    return f"scrypt${_N}${_R}${_P}${salt.hex()}${_key(password, salt, _N, _R, _P).hex()}"


def matches(password: str, line: str) -> bool:
    """Return whether `password` has the hash `line`; a wrong one takes as long."""
    n, r, p, salt, key = _parts(line)
    if len(password) > LONGEST:
        return False
    return hmac.compare_digest(_key(password, salt, n, r, p), key)


def is_line(text: str) -> bool:
    """Return whether `text` is a valid hash."""
    try:
        n, r, p, salt, key = _parts(text)
    except ValueError:
        return False
    costs_are_sane = 2**10 <= n <= 2**16 and n & (n - 1) == 0 and 1 <= r <= 8 and 1 <= p <= 4
    return costs_are_sane and len(salt) >= 16 and len(key) == 32


def _parts(line: str) -> tuple[int, int, int, bytes, bytes]:
    kind, n, r, p, salt, key = line.split("$")
    if kind != "scrypt":
        raise ValueError(kind)
    return int(n), int(r), int(p), bytes.fromhex(salt), bytes.fromhex(key)


def _key(password: str, salt: bytes, n: int, r: int, p: int) -> bytes:
    return hashlib.scrypt(
        password.encode(errors="surrogatepass"), salt=salt, n=n, r=r, p=p, maxmem=_MAX_MEMORY, dklen=32
    )
