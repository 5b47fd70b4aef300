"""The router's access control in zenoh's format: what each account may publish, query and answer.  Pure.

Rule 1: what is not allowed here is denied to all accounts.
Rule 2: all accounts may read; only the gateway publishes states, and only the twin publishes twin/*.
Rule 3: a user's command has the key `command/as/<role>/<name>` with the user's own role and name.  The gateway decides
        whether the role suffices (roles.py), because it can give a reason and log the attempt, which the router cannot.
Rule 4: the views' account may send under any name: OPC UA and the web page have checked the password themselves.
Rule 5: the gateway's account serves the log of its site, and all accounts may ask for it.
Rule 6: where this router connects to another one, that one, known by its certificate, reads everything and asks for
        logs.  It cannot send commands, because nothing here has checked their senders.
Rule 7: over TLS and QUIC a password is valid only together with the certificate of the same name.  The other protocols
        have no certificates; `listeners.py` restricts them to this machine.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gateway.access.roles import Role
from protocol.bus import topics

SERVICES = ("gateway", "twin", "views")  # reserved names; users cannot have them
ROUTER = "bus-router"  # common name of the certificates of routers
LARGEST_COMMAND = 65_536  # bytes that pass the router; the gateway refuses commands over 4 KiB as "oversize"
LARGEST_MODEL = 4_000_000  # bytes
LARGEST_LOG_REQUEST = 1_000_000  # bytes
LARGEST_MESSAGE = 16_000_000  # bytes of a fragmented message

_WITHOUT_CERTIFICATES = ("tcp", "udp", "ws", "serial", "unixsock-stream", "unixpipe", "vsock")  # zenoh's names
_READ = ("declare_subscriber", "declare_liveliness_subscriber", "liveliness_query")
_DELIVERED = ("put", "delete", "reply", "liveliness_token")
_SERVED = ("query", "declare_subscriber", "declare_queryable")  # messages that a publisher or queryable must receive


def access_control(site: str, people: Mapping[str, Role], *, upper: bool = False) -> dict[str, Any]:
    """The `access_control` section of a router for one site; `upper`: it connects to another router."""
    published = {
        who: [topics.key(site, "*", t.name) for t in topics.TOPICS if t.bus and t.source == who]
        for who in ("gateway", "twin")
    }
    everything, logs = [f"{site}/**"], [f"{site}/{topics.LOGS}/*"]
    rules = [
        _rule("asks-logs", "ingress", ("query",), logs),
        _rule("serves-logs", "ingress", ("declare_queryable", "reply"), logs),
        _rule("read", "ingress", _READ, everything),
        _rule("told", "egress", _DELIVERED, everything),
        _rule("served", "egress", _SERVED, everything),
    ]
    policies: list[dict[str, Any]] = []
    for service, topic, alive in (
        ("gateway", "command", topics.key(site, "*", topics.ALIVE)),
        ("twin", "twin/command", f"{site}/*/{topics.TWIN_ALIVE}/*"),
    ):
        rules += [
            _rule(f"{service}-lives", "ingress", ("liveliness_token",), [alive]),
            _rule(f"{service}-puts", "ingress", ("put",), published[service]),
            _rule(f"{service}-answers", "ingress", ("declare_queryable", "reply"), [_as(site, topic, "*", "*")]),
        ]
        rights = [f"{service}-{what}" for what in ("puts", "answers", "lives")]
        policies.append({"subjects": _subject_ids(service), "rules": ["read", "told", "served", "asks-logs", *rights]})
    policies[0]["rules"].append("serves-logs")
    senders = {"views": ("*", "*"), **{name: (role.word, name) for name, role in people.items()}}
    for name, (role, who) in senders.items():
        keys = [_as(site, topic, role, who) for topic in ("command", "twin/command")]
        rules.append(_rule(f"{name}-commands", "ingress", ("query",), keys))
        policies.append({"subjects": _subject_ids(name), "rules": ["read", "told", "asks-logs", f"{name}-commands"]})
    subjects = [subject for name in (*SERVICES, *people) for subject in _subjects(name)]
    if upper:
        subjects.append({"id": ROUTER, "cert_common_names": [ROUTER]})
        policies.append({"subjects": [ROUTER], "rules": ["read", "told", "served", "asks-logs"]})
    return {"enabled": True, "default_permission": "deny", "rules": rules, "subjects": subjects, "policies": policies}


def size_limits(site: str) -> list[dict[str, Any]]:
    """The `low_pass_filter` section of a router's configuration: it drops larger messages."""
    sizes = (
        ("command", _as(site, "command", "*", "*"), LARGEST_COMMAND),
        ("twin-command", _as(site, "twin/command", "*", "*"), LARGEST_MODEL),
        ("log-request", f"{site}/{topics.LOGS}/*", LARGEST_LOG_REQUEST),
    )
    return [
        {"id": f"largest-{what}", "flows": ["ingress"], "messages": ["query"], "key_exprs": [key], "size_limit": size}
        for what, key, size in sizes
    ]


def _subjects(name: str) -> list[dict[str, Any]]:
    """Zenoh's subjects of an account; in a subject all lists must match, each by one of its entries."""
    certified, plain = _subject_ids(name)
    return [
        {"id": certified, "usernames": [name], "cert_common_names": [name]},
        {"id": plain, "usernames": [name], "link_protocols": list(_WITHOUT_CERTIFICATES)},
    ]


def _subject_ids(name: str) -> list[str]:
    return [name, f"{name}-without-certificate"]


def _as(site: str, topic: str, role: str, who: str) -> str:
    return f"{topics.key(site, '*', topic)}/{topics.AS}/{role}/{who}"


def _rule(name: str, flow: str, messages: Sequence[str], keys: Sequence[str]) -> dict[str, Any]:
    return {"id": name, "permission": "allow", "flows": [flow], "messages": list(messages), "key_exprs": list(keys)}
