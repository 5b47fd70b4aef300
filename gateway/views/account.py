"""Who a view is on a guarded bus: the views' service account, which may send commands for people it has checked."""

from __future__ import annotations

from protocol.bus.identity import Identity, find_identity
from protocol.errors import ConfigError

ACCOUNT = "views"


def views_identity(folder: str | None) -> Identity | None:
    """The identity in `folder` or BOARD51_IDENTITY; None on an unguarded bus.

    Raises:
        ConfigError: it is not usable, or somebody's own.
    """
    identity = find_identity(folder)
    if identity is not None and identity.role != ACCOUNT:
        raise ConfigError(
            f"The identity {identity.name} cannot send commands for others",
            remedy=f"Give --identity DIR/identities/{ACCOUNT}",
        )
    return identity
