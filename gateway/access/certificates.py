"""Certificates of one plant: a private authority, the certificates that it issues, and their validity.

All keys are RSA with 2048 bits, which OPC UA's Basic256Sha256 requires, and which zenoh and HTTPS accept, too.
Browsers and other programs do not trust the authority until it is installed there.

Rule: a certificate is valid from a day before it was made, because the clocks of hosts differ.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from cryptography.x509.oid import ExtendedKeyUsageOID, NameOID

from protocol.errors import ConfigError
from protocol.files import open_regular

CA_DAYS = 3650
DAYS = 825  # validity of the certificates that it issues
WARN_DAYS = 30
_KEY_BITS = 2048
_BACKDATED = timedelta(days=1)


@dataclass(frozen=True, slots=True, kw_only=True)
class Issued:
    """A certificate with its key, both PEM."""

    certificate: bytes
    key: bytes
    valid_until: datetime


class Authority:
    """A certificate authority."""

    def __init__(self, certificate: x509.Certificate, key: rsa.RSAPrivateKey) -> None:
        self._certificate, self._key = certificate, key

    @classmethod
    def create(cls, name: str, *, now: datetime, days: float = CA_DAYS) -> tuple[Authority, Issued]:
        """Create an authority; returns it with its certificate and key, which must be stored."""
        key = rsa.generate_private_key(public_exponent=65537, key_size=_KEY_BITS)
        subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
        certificate = (
            _builder(subject, subject, key.public_key(), now, days)
            .add_extension(x509.BasicConstraints(ca=True, path_length=0), critical=True)
            .add_extension(_usage(authority=True), critical=True)
            .sign(key, hashes.SHA256())
        )
        return cls(certificate, key), _issued(certificate, key)

    @classmethod
    def load(cls, certificate: bytes, key: bytes) -> Authority:
        """Load an authority from the PEM data of `create`.  Raises ValueError if they are not valid."""
        loaded = serialization.load_pem_private_key(key, password=None)
        if not isinstance(loaded, rsa.RSAPrivateKey):
            raise ValueError("not an RSA key")
        return cls(x509.load_pem_x509_certificate(certificate), loaded)

    def issue(
        self, name: str, *, now: datetime, hosts: Sequence[str] = (), uris: Sequence[str] = (), days: float = DAYS
    ) -> Issued:
        """Issue a client certificate, which is also a server certificate if hosts are given.

        The certificate is valid for `days`; if negative, it has expired.  OPC UA wants the server's application URI.
        """
        key = rsa.generate_private_key(public_exponent=65537, key_size=_KEY_BITS)
        subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
        names: list[x509.GeneralName] = [x509.UniformResourceIdentifier(uri) for uri in uris]
        names += [_host(host) for host in hosts]
        purposes = [ExtendedKeyUsageOID.CLIENT_AUTH, *([ExtendedKeyUsageOID.SERVER_AUTH] if hosts else [])]
        builder = (
            _builder(subject, self._certificate.subject, key.public_key(), now, days)
            .add_extension(x509.BasicConstraints(ca=False, path_length=None), critical=True)
            .add_extension(_usage(authority=False), critical=True)
            .add_extension(x509.ExtendedKeyUsage(purposes), critical=False)
            .add_extension(x509.AuthorityKeyIdentifier.from_issuer_public_key(self._key.public_key()), critical=False)
        )
        if names:
            builder = builder.add_extension(x509.SubjectAlternativeName(names), critical=False)
        return _issued(builder.sign(self._key, hashes.SHA256()), key)


def check_certificate(path: Path, *, what: str, now: datetime | None = None) -> x509.Certificate:
    """Return a certificate in PEM that is valid now, or at the time given; `what` describes it in errors.

    Raises:
        ConfigError: the file is missing or not a certificate, or the certificate is expired or not yet valid.
    """
    now = datetime.now(UTC) if now is None else now
    try:
        with open_regular(
            path, remedy="Make it with `board51 security init`", what=f"{what} ", error=ConfigError
        ) as file:
            certificate = x509.load_pem_x509_certificate(file.read())
    except ValueError:
        raise ConfigError(f"{what} {path} is not a certificate in PEM", remedy="Give one, or renew it") from None
    if now >= certificate.not_valid_after_utc:
        problem = f"{what} {path} expired on {certificate.not_valid_after_utc:%Y-%m-%d}"
        raise ConfigError(problem, remedy="Renew it with `board51 security renew DIR`")
    if now < certificate.not_valid_before_utc:
        problem = f"{what} {path} is not valid before {certificate.not_valid_before_utc:%Y-%m-%d}"
        raise ConfigError(problem, remedy="Set this machine's clock right")
    return certificate


def days_left(certificate: x509.Certificate, now: datetime) -> float:
    """Return the days for which a certificate is still valid."""
    return (certificate.not_valid_after_utc - now).total_seconds() / 86400


def _builder(
    subject: x509.Name, issuer: x509.Name, key: rsa.RSAPublicKey, now: datetime, days: float
) -> x509.CertificateBuilder:
    end = now + timedelta(days=days)
    return (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(issuer)
        .public_key(key)
        .serial_number(x509.random_serial_number())
        .not_valid_before(min(now, end) - _BACKDATED)
        .not_valid_after(end)
        .add_extension(x509.SubjectKeyIdentifier.from_public_key(key), critical=False)
    )


def _usage(*, authority: bool) -> x509.KeyUsage:
    return x509.KeyUsage(
        digital_signature=True,
        content_commitment=not authority,
        key_encipherment=not authority,
        data_encipherment=not authority,
        key_agreement=False,
        key_cert_sign=authority,
        crl_sign=authority,
        encipher_only=False,
        decipher_only=False,
    )


def _host(host: str) -> x509.GeneralName:
    try:
        return x509.IPAddress(ipaddress.ip_address(host))
    except ValueError:
        return x509.DNSName(host)


def _issued(certificate: x509.Certificate, key: rsa.RSAPrivateKey) -> Issued:
    return Issued(
        certificate=certificate.public_bytes(serialization.Encoding.PEM),
        key=key.private_bytes(
            serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
        ),
        valid_until=certificate.not_valid_after_utc,
    )
