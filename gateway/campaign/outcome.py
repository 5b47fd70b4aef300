"""Options and results of a run.  Pure."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Literal

from protocol.campaign import Plant
from protocol.experiments import EXPERIMENT_OF_NAME, LIFT_OFF, Experiment

Standing = Literal["recorded", "already-there", "given-up", "impossible", "skipped", "interrupted", "not-reached"]


@dataclass(slots=True, kw_only=True)
class Outcome:
    """The result of one experiment."""

    experiment: Experiment
    standing: Standing = "not-reached"
    attempts: int = 0
    seconds: float = 0.0
    problems: list[str] = field(default_factory=list)

    @property
    def is_recorded(self) -> bool:
        """Return whether the recording is in the folder."""
        return self.standing in ("recorded", "already-there")


@dataclass(slots=True, kw_only=True)
class Summary:
    """The result of a run."""

    outcomes: list[Outcome]
    lift_off_v: float | None = None
    interrupted: bool = False
    failure: str = ""  # the error that ended it
    parked: str = ""  # "": the board is stopped; otherwise why STOP could not be delivered
    restored: list[str] = field(default_factory=list)
    rig_s: float = 0.0  # of the board's time, from the first command to the last

    @property
    def complete(self) -> bool:
        """Return whether all requested experiments are in the folder or were skipped, and the run ended normally."""
        all_complete = all(o.is_recorded or o.standing == "skipped" for o in self.outcomes)
        return all_complete and not (self.interrupted or self.failure or self.parked)


@dataclass(frozen=True, slots=True, kw_only=True)
class Wishes:
    """The options of the user."""

    experiments: tuple[Experiment, ...]
    plant: Plant
    lift_off: Experiment = EXPERIMENT_OF_NAME[LIFT_OFF]  # recorded first if its result is needed and unknown
    seed: int = 1
    quick: bool = False
    park: bool = False  # a board that is in use is stopped first
    u_max_v: float | None = None
    x_min_m: float | None = None
    x_max_m: float | None = None
    # Called before an experiment with manual preparation; returns "" to go ahead, otherwise the reason to skip it.
    prepare: Callable[[Experiment], str] = lambda experiment: "it needs a person"
