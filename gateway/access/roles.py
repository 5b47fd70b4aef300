"""The table of rights: the minimum role for each action.  Pure.

Rule 1: all decisions about rights (gateway, OPC UA, web page, the router's access control) use this table.
Rule 2: an action that is not in the table is not allowed.
Rule 3: every user may send STOP, so that anyone who sees a danger can act at once.  A viewer can drop the ball this
        way; the log has the name.
"""

from __future__ import annotations

import enum

from protocol.errors import ConfigError


class Role(enum.IntEnum):
    """The roles in rising order; each has the rights of those below."""

    VIEWER = 1
    OPERATOR = 2
    ENGINEER = 3

    @property
    def word(self) -> str:
        """The role's name in files, keys and the log, such as `operator`."""
        return self.name.lower()


ROLE_WORDS = tuple(role.word for role in Role)

# Commands by the name of their field in pb.Command and pb.TwinCommand, then actions of views that are not commands.
MINIMUM_ROLE: dict[str, Role] = {
    "read": Role.VIEWER,  # published data, logs, reports
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
    "set_plant": Role.ENGINEER,  # K_c and b of every model rest on it
    "set_stream": Role.ENGINEER,
    "set_host_loss": Role.ENGINEER,
    "use_model": Role.ENGINEER,  # of the twin
    "delete_log": Role.ENGINEER,
    "diagnose": Role.ENGINEER,  # and identify: minutes of the machine's time
    "campaign": Role.ENGINEER,  # sets the stream divider among other things
    "disable_alarm": Role.ENGINEER,  # of OPC UA: its clients do not receive the alarm until it is enabled again
}


def parse_role(word: str, *, where: str) -> Role:
    """Return the role of that name.

    Raises:
        ConfigError: it is not a role; the message gives `where`, the word and the roles.
    """
    if word not in ROLE_WORDS:
        raise ConfigError(f"{where}: {word!r} is not a role", remedy=f"Write one of {', '.join(ROLE_WORDS)}")
    return Role[word.upper()]


def may(role: Role, act: str) -> bool:
    """Return whether `role` may perform `act`, a key of MINIMUM_ROLE."""
    minimum = MINIMUM_ROLE.get(act)
    return minimum is not None and role >= minimum


def refusal_text(who: str, role: Role, act: str) -> str:
    """Return a sentence for a reply with the reason `not-allowed`."""
    minimum = MINIMUM_ROLE.get(act)
    needs = f"it needs the role {minimum.word}" if minimum is not None else "nobody may"
    return f"{who} ({role.word}) may not {act.replace('_', ' ')}: {needs}."
