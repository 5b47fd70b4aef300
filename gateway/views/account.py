"""Identity of a view on a guarded bus: a service account that may send commands for users it has authenticated."""

from __future__ import annotations

from protocol.bus.identity import Identity, find_identity
from protocol.errors import ConfigError

ACCOUNT = "views"


def views_identity(folder: str | None) -> Identity | None:
    """Return the identity in `folder` or BOARD51_IDENTITY; None on an unguarded bus.

    Raises:
        ConfigError: the identity is not usable, or belongs to a person.
    """
    identity = find_identity(folder)
    if identity is not None and identity.role != ACCOUNT:
        raise ConfigError(
            f"The identity {identity.name} cannot send commands for others",
            remedy=f"Give --identity DIR/identities/{ACCOUNT}",
        )
    return identity
