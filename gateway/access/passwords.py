"""A password as a line of text that does not give it away: scrypt with a salt.

`scrypt$<n>$<r>$<p>$<salt>$<key>`, salt and key in hexadecimal.  The costs are in the line, so that they can be raised
for new passwords without losing the old ones.
"""

from __future__ import annotations

import hashlib
import hmac
import secrets

from protocol.errors import UsageError

_N, _R, _P = 2**14, 8, 1  # 16 MiB and about 50 ms: one try costs an attacker what it costs us
_MAX_MEMORY = 64 * 2**20
SHORTEST = 8
LONGEST = 256  # characters; a megabyte of password is an attack
NOBODY = f"scrypt${_N}${_R}${_P}${'00' * 16}${'00' * 32}"  # matches no password; costs what a real one does


def hash_password(password: str) -> str:
    """The line for `password`.

    Raises:
        UsageError: too short or too long.
    """
    if not SHORTEST <= len(password) <= LONGEST:
        raise UsageError(
            f"The password has {len(password)} characters", remedy=f"Choose {SHORTEST} to {LONGEST} characters"
        )
    salt = secrets.token_bytes(16)
    return f"scrypt${_N}${_R}${_P}${salt.hex()}${_key(password, salt, _N, _R, _P).hex()}"


def matches(password: str, line: str) -> bool:
    """Whether `password` is the one of `line`; takes as long for a wrong one."""
    n, r, p, salt, key = _parts(line)
    if len(password) > LONGEST:
        return False
    return hmac.compare_digest(_key(password, salt, n, r, p), key)


def is_line(text: str) -> bool:
    """Whether `text` has the form of a line."""
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
