"""THE table of rights: which role each act needs at least.  Pure.

Rule 1: whoever decides about rights (gateway, OPC UA, web page, the router's access control) asks this table.
Rule 2: an act that is not in the table is not allowed to anybody.
Rule 3: STOP is everybody's who is let in: who sees that something goes wrong must not have to look for somebody else.
        A viewer can drop a ball that way; the log says who did.
"""

from __future__ import annotations

import enum

from protocol.errors import ConfigError


class Role(enum.IntEnum):
    """Ordered: each role may do what the one below may."""

    VIEWER = 1
    OPERATOR = 2
    ENGINEER = 3

    @property
    def word(self) -> str:
        """As in files, keys and the log: `operator`."""
        return self.name.lower()


ROLE_WORDS = tuple(role.word for role in Role)

# Kinds of pb.Command and pb.TwinCommand by the name of their field, then acts of views that are no command.
LEAST_ROLE: dict[str, Role] = {
    "read": Role.VIEWER,  # everything published, logs, reports
    "ping": Role.VIEWER,
    "stop": Role.VIEWER,
    "set_mode": Role.OPERATOR,
    "set_reference": Role.OPERATOR,
    "excite": Role.OPERATOR,
    "capture": Role.OPERATOR,
    "acknowledge": Role.OPERATOR,  # an alarm
    "mark": Role.OPERATOR,  # a remark in the log
    "recording": Role.OPERATOR,  # start, stop
    "set_gains": Role.ENGINEER,
    "set_stream": Role.ENGINEER,
    "set_host_loss": Role.ENGINEER,
    "use_model": Role.ENGINEER,  # of the twin
    "campaign": Role.ENGINEER,  # sets the stream divider among other things
    "disable_alarm": Role.ENGINEER,  # of OPC UA: its clients are not told of it until it is enabled
}


def parse_role(word: str, *, where: str) -> Role:
    """The role of that name.

    Raises:
        ConfigError: names `where`, the word and the allowed ones.
    """
    if word not in ROLE_WORDS:
        raise ConfigError(f"{where}: {word!r} is not a role", remedy=f"Write one of {', '.join(ROLE_WORDS)}")
    return Role[word.upper()]


def may(role: Role, act: str) -> bool:
    """Whether `role` may do `act`, a key of LEAST_ROLE."""
    least = LEAST_ROLE.get(act)
    return least is not None and role >= least


def refusal_text(who: str, role: Role, act: str) -> str:
    """One sentence for a reply with the reason `not-allowed`."""
    least = LEAST_ROLE.get(act)
    needs = f"it needs the role {least.word}" if least is not None else "nobody may"
    return f"{who} ({role.word}) may not {act.replace('_', ' ')}: {needs}."
