"""Certificate, key and users of a secured server, from the folder that `board51 security init` made.

A client application must show a certificate that the plant's authority signed, or one in `opcua/trusted/` (PEM or DER).
SCADA systems bring their own.  A person logs in with name and password, or with the
certificate of their identity, whose common name is theirs; the role is that of users.toml in either case.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path

from asyncua import ua
from asyncua.common.utils import ServiceError
from cryptography import x509
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.x509.oid import NameOID

from gateway.access.certificates import WARN_DAYS, check_certificate, days_left
from gateway.access.folder import OPCUA_URI, SecurityFolder
from gateway.access.logins import Logins, TooMany
from gateway.access.private import read_private
from gateway.access.users import User, Users
from protocol.errors import ConfigError

S = ua.StatusCodes
_RENEW = "Renew both with `board51 security renew`"
_HASH = hashes.SHA256()
_logger = logging.getLogger("gateway.opcua")


class Security:
    """Raises ConfigError where a file in the folder is absent, expired or open to others; the text says which."""

    application_uri = OPCUA_URI

    def __init__(self, path: Path, *, clock: Callable[[], float] = time.monotonic) -> None:
        folder = SecurityFolder(path)
        certificate, key = folder.server("opcua")
        loaded = check_certificate(certificate, what="The certificate of OPC UA")
        days = days_left(loaded, datetime.now(UTC))
        if days < WARN_DAYS:
            _logger.warning("%s expires in %.0f days: `board51 security renew`", certificate, days)
        self.key_pem = read_private(key, what="The key of OPC UA")
        try:
            public_key = serialization.load_pem_private_key(self.key_pem, password=None).public_key()
        except (ValueError, TypeError):
            raise ConfigError(f"{key} is not a key in PEM without a password", remedy=_RENEW) from None
        if public_key != loaded.public_key():
            raise ConfigError(f"{key} is not the key of {certificate}", remedy=_RENEW)
        self.certificate_der = loaded.public_bytes(serialization.Encoding.DER)
        self._authority = check_certificate(folder.ca, what="The authority's certificate")
        self._users = Users(folder.users)
        self._logins = Logins(self._users, clock=clock)
        self._trusted = path / "opcua" / "trusted"

    def identify(self, name: str | None, password: str | None, certificate: bytes | None, host: str) -> User | None:
        """Return the user; None for a wrong password, an unknown certificate or an unknown name.

        Raises:
            ServiceError: too many passwords were tried from this host.
        """
        if name is None:
            return self._of_certificate(certificate or b"")
        user = self._logins.at_once(name, password or "", host)
        if isinstance(user, TooMany):
            raise ServiceError(S.BadTooManyOperations)
        return user

    async def check_client(self, certificate: x509.Certificate, application: ua.ApplicationDescription) -> None:
        """The certificate of a client application; raises ServiceError where it is not to be let in."""
        if not _is_valid_now(certificate):
            raise ServiceError(S.BadCertificateTimeInvalid)
        if self._is_signed(certificate) or certificate.fingerprint(_HASH) in self._trusted_prints():
            return
        subject = certificate.subject.rfc4514_string()
        _logger.warning("refused a client with the certificate of %s: not trusted", subject)
        raise ServiceError(S.BadCertificateUntrusted)

    def _of_certificate(self, der: bytes) -> User | None:
        try:
            certificate = x509.load_der_x509_certificate(der)
        except ValueError:
            return None
        names = certificate.subject.get_attributes_for_oid(NameOID.COMMON_NAME)
        if len(names) != 1 or not _is_valid_now(certificate) or not self._is_signed(certificate):
            return None
        return self._users.find(str(names[0].value))

    def _is_signed(self, certificate: x509.Certificate) -> bool:
        try:
            certificate.verify_directly_issued_by(self._authority)
        except (ValueError, TypeError, InvalidSignature):
            return False
        return True

    def _trusted_prints(self) -> set[bytes]:
        prints: set[bytes] = set()
        for file in sorted(self._trusted.glob("*")):
            try:
                data = file.read_bytes()
                pem = data.lstrip().startswith(b"-----BEGIN")
                trusted = x509.load_pem_x509_certificate(data) if pem else x509.load_der_x509_certificate(data)
            except (OSError, ValueError) as error:
                _logger.warning("%s is not a certificate: %s", file, error)
                continue
            prints.add(trusted.fingerprint(_HASH))
        return prints


def _is_valid_now(certificate: x509.Certificate) -> bool:
    return certificate.not_valid_before_utc <= datetime.now(UTC) < certificate.not_valid_after_utc
