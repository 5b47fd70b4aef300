"""The router's access control as zenoh wants it: what each of us may put, ask and answer.  Pure.

Rule 1: what is not allowed here is denied, for everybody.
Rule 2: everybody who is let in at all may read; only the gateway puts states, only the twin puts twin/*.
Rule 3: a person's command goes under `command/as/<role>/<name>`, and under no other role or name.  Whether the role
        suffices is the gateway's decision (roles.py): it says why, and logs the attempt.  The router says nothing.
Rule 4: the views' account may send as anybody: OPC UA and the web page have checked the password themselves.
Rule 5: over TLS and QUIC a password counts only together with the certificate of the same name.  The other protocols
        know no certificates; `listeners.py` keeps them on this machine.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gateway.access.roles import Role
from protocol.bus import topics

SERVICES = ("gateway", "twin", "views")  # names that are nobody's login
LARGEST_COMMAND = 65_536  # bytes that pass the router; the gateway says "oversize" from 4 KiB on
LARGEST_MODEL = 4_000_000
LARGEST_MESSAGE = 16_000_000  # bytes that the router puts together from fragments

_WITHOUT_CERTIFICATES = ("tcp", "udp", "ws", "serial", "unixsock-stream", "unixpipe", "vsock")  # zenoh's words
_READ = ("declare_subscriber", "declare_liveliness_subscriber", "liveliness_query")
_TOLD = ("put", "delete", "reply", "liveliness_token")
_SERVED = ("query", "declare_subscriber", "declare_queryable")  # what a publisher or queryable must hear of others


def access_control(site: str, people: Mapping[str, Role]) -> dict[str, Any]:
    """The `access_control` of a router for one site."""
    published = {
        who: [topics.key(site, "*", t.name) for t in topics.TOPICS if t.bus and t.by == who]
        for who in ("gateway", "twin")
    }
    everything = [f"{site}/**"]
    rules = [
        _rule("read", "ingress", _READ, everything),
        _rule("told", "egress", _TOLD, everything),
        _rule("served", "egress", _SERVED, everything),
    ]
    policies: list[dict[str, Any]] = []
    for service, topic in (("gateway", "command"), ("twin", "twin/command")):
        rules += [
            _rule(f"{service}-puts", "ingress", ("put",), published[service]),
            _rule(f"{service}-answers", "ingress", ("declare_queryable", "reply"), [_as(site, topic, "*", "*")]),
        ]
        names = ["read", "told", "served", f"{service}-puts", f"{service}-answers"]
        policies.append({"subjects": _subject_ids(service), "rules": names})
    rules.append(_rule("gateway-lives", "ingress", ("liveliness_token",), [topics.key(site, "*", topics.ALIVE)]))
    policies[0]["rules"].append("gateway-lives")
    senders = {"views": ("*", "*"), **{name: (role.word, name) for name, role in people.items()}}
    for name, (role, who) in senders.items():
        keys = [_as(site, topic, role, who) for topic in ("command", "twin/command")]
        rules.append(_rule(f"{name}-commands", "ingress", ("query",), keys))
        policies.append({"subjects": _subject_ids(name), "rules": ["read", "told", f"{name}-commands"]})
    return {
        "enabled": True,
        "default_permission": "deny",
        "rules": rules,
        "subjects": [subject for name in (*SERVICES, *people) for subject in _subjects(name)],
        "policies": policies,
    }


def size_limits(site: str) -> list[dict[str, Any]]:
    """The `low_pass_filter` of a router: what is larger is dropped before it costs anybody else anything."""
    sizes = (("command", LARGEST_COMMAND), ("twin/command", LARGEST_MODEL))
    return [
        {
            "id": f"largest-{topic.replace('/', '-')}",
            "flows": ["ingress"],
            "messages": ["query"],
            "key_exprs": [_as(site, topic, "*", "*")],
            "size_limit": size,
        }
        for topic, size in sizes
    ]


def _subjects(name: str) -> list[dict[str, Any]]:
    """Whom zenoh takes for `name`: within a subject the lists must all match, and one entry of each list is enough."""
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
    return {
        "id": name,
        "permission": "allow",
        "flows": [flow],
        "messages": list(messages),
        "key_exprs": list(keys),
    }
