"""What a run was asked for, and what became of it.  Pure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

from gateway.campaign.menu import BY_NAME, LIFT_OFF, Experiment
from protocol.campaign import Plant

Standing = Literal["recorded", "already-there", "given-up", "impossible", "skipped", "interrupted", "not-reached"]


@dataclass(slots=True, kw_only=True)
class Outcome:
    """What became of one experiment."""

    experiment: Experiment
    standing: Standing = "not-reached"
    attempts: int = 0
    seconds: float = 0.0
    said: list[str] = field(default_factory=list)

    @property
    def is_there(self) -> bool:
        """Whether the folder holds it."""
        return self.standing in ("recorded", "already-there")


@dataclass(slots=True, kw_only=True)
class Summary:
    """The whole run."""

    outcomes: list[Outcome]
    lift_off_v: float | None = None
    interrupted: bool = False
    failure: str = ""  # the error that ended it
    parked: str = ""  # "" or why STOP could not be delivered
    restored: list[str] = field(default_factory=list)
    rig_s: float = 0.0  # of the board's time, from the first command to the last

    @property
    def complete(self) -> bool:
        """Everything that was asked for is in the folder."""
        settled = all(o.is_there or o.standing == "skipped" for o in self.outcomes)
        return settled and not (self.interrupted or self.failure or self.parked)


@dataclass(frozen=True, slots=True, kw_only=True)
class Wishes:
    """What the user asked for."""

    experiments: tuple[Experiment, ...]
    plant: Plant
    lift_off: Experiment = BY_NAME[LIFT_OFF]  # recorded first where its result is needed and not known
    seed: int = 1
    u_max_v: float | None = None
    x_min_m: float | None = None
    x_max_m: float | None = None
    # Asked before an experiment that needs a person; "" goes ahead, else why not.
    ask: Callable[[Experiment], str] = lambda experiment: "it needs a person"
