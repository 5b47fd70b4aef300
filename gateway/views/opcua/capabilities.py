"""Capabilities of the server under Server/ServerCapabilities.

Rule: a profile is listed when everything that it demands of a server works and is tested.  Core and subscription facets
      are not listed: asyncua ignores the largest number of references of a Browse, and marks no queue that has
      overflowed.  Nor is the facet of event filters, because asyncua has no LIKE.
"""

from __future__ import annotations

from collections.abc import Iterable

from asyncua import Server, ua

from gateway.views.opcua.address_space.history import MAX_VALUES
from gateway.views.opcua.sessions import MAX_CONNECTIONS, MAX_QUEUE, MAX_SUBSCRIPTIONS
from gateway.views.opcua.subscriptions import MAX_ITEMS

_PROFILE = "http://opcfoundation.org/UA-Profile"
_POLICY = "http://opcfoundation.org/UA/SecurityPolicy#"
_FACETS = "DataAccess Methods HistoricalRawData ACBaseCondition ACRefresh2 ACEnable ACAlarm ACAckAlarm"
FACETS = tuple(f"{_PROFILE}/Server/{name}" for name in _FACETS.split())
TRANSPORT = f"{_PROFILE}/Transport/uatcp-uasc-uabinary"
_OF_POLICY = {
    "NoSecurity": f"{_POLICY}None",
    "Basic256Sha256": f"{_POLICY}Basic256Sha256",
    "Aes128Sha256RsaOaep": f"{_POLICY}Aes128_Sha256_RsaOaep",
    "Aes256Sha256RsaPss": f"{_POLICY}Aes256_Sha256_RsaPss",
}
_OF_TOKEN: dict[type, str] = {
    ua.AnonymousIdentityToken: f"{_PROFILE}/Security/UserToken/Anonymous",
    ua.UserNameIdentityToken: f"{_PROFILE}/Security/UserToken/Server/UserNamePassword",
    ua.X509IdentityToken: f"{_PROFILE}/Security/UserToken/Server/X509Certificate",
}
_O, _V = ua.ObjectIds, ua.VariantType
_LIMITS = {
    _O.Server_ServerCapabilities_MaxSessions: MAX_CONNECTIONS,
    _O.Server_ServerCapabilities_MaxSubscriptions: MAX_SUBSCRIPTIONS,
    _O.Server_ServerCapabilities_MaxMonitoredItemsPerSubscription: MAX_ITEMS,
    _O.Server_ServerCapabilities_MaxMonitoredItemsQueueSize: MAX_QUEUE,
    _O.HistoryServerCapabilities_MaxReturnDataValues: MAX_VALUES,
    _O.HistoryServerCapabilities_MaxReturnEventValues: 0,
}
_HISTORY = {  # what a history might be able to do, and whether ours is
    node: name.endswith(("AccessHistoryDataCapability", "ServerTimestampSupported"))
    for name, node in vars(_O).items()
    if name.startswith("HistoryServerCapabilities_") and name.endswith(("Capability", "Supported"))
}


async def describe(
    server: Server, policies: Iterable[ua.SecurityPolicyType], tokens: Iterable[type], interval_ms: float
) -> None:
    """Fill in the capabilities of a server with these security policies and logins, and this interval of its values."""
    offered = [_OF_POLICY[policy.name.partition("_")[0]] for policy in policies]
    profiles = [TRANSPORT, *offered, *(_OF_TOKEN[token] for token in tokens), *FACETS]
    values = {
        _O.Server_ServerCapabilities_ServerProfileArray: ua.Variant(profiles, _V.String),
        _O.Server_ServerCapabilities_LocaleIdArray: ua.Variant(["en"], _V.String),
        _O.Server_ServerCapabilities_MinSupportedSampleRate: ua.Variant(interval_ms, _V.Double),
    }
    values |= {node: ua.Variant(limit, _V.UInt32) for node, limit in _LIMITS.items()}
    values |= {node: ua.Variant(able, _V.Boolean) for node, able in _HISTORY.items()}
    for node, value in values.items():
        await server.get_node(ua.NodeId(node)).write_value(value)
