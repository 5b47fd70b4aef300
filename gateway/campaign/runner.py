"""Run a campaign: sequence of the experiments, repetitions, and the end.

Rule 1: each experiment begins and ends parked: mode idle, coil off, ball at rest.
Rule 2: every end of the run (done, Ctrl-C, a lost board, a full disk) is through `_leave`: STOP, then restore reference
        and stream.
Rule 3: an unusable recording is repeated at most twice, with changes if these help, and then given up.  The other
        experiments do not depend on it, except on the lift-off input.
"""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from dataclasses import replace

from gateway.board.emulated import is_emulated
from gateway.campaign import checks
from gateway.campaign.control import Cut, RigControl, Stopped
from gateway.campaign.folder import Folder, Retained, controller_of, identity_of, plan_of
from gateway.campaign.outcome import Outcome, Summary, Wishes
from gateway.campaign.plan import (
    Action,
    CommandLimits,
    GoTo,
    Scale,
    Send,
    actions_of,
    guessed_lift_off_v,
    limits_of,
    needs_lift_off,
    raised,
)
from gateway.campaign.subscriber import BoardSubscriber, Recorded, is_foreign
from gateway.client.values import Sample, Samples
from protocol.bus import board51_pb2 as pb
from protocol.bus import encoding
from protocol.errors import Board51Error, ServiceError
from protocol.experiments import LIFT_OFF, Experiment

ATTEMPTS = 3
LOWERED = 0.7  # amplitudes of a repetition after the ball fell or something was clipped
OVERHEAD_S = {True: 2.0, False: 0.8}  # of a recording in closed and in open loop: lifting, landing, writing


class Runner:
    """Runs the experiments of `wishes` on `rig` into `folder`."""

    def __init__(
        self,
        rig: RigControl,
        subscriber: BoardSubscriber,
        folder: Folder,
        board: str,
        wishes: Wishes,
        write_line: Callable[[str], None],
    ) -> None:
        self._rig, self._subscriber, self._folder, self._board = rig, subscriber, folder, board
        self._wishes, self._write_line = wishes, write_line
        self._limits: CommandLimits
        self._parameters: pb.Parameters
        self._x_ref_m: float | None = None

    def run(self) -> Summary:
        """Perform all experiments; the board is parked at the end.

        Raises:
            UsageError: limits, folder or plan do not allow the run; the ball has not moved.
            ServiceError: the board is missing or in use; the ball has not moved.
        """
        state, self._parameters = self._rig.await_board()
        if state.mode != pb.MODE_IDLE and not self._wishes.park:
            raise ServiceError(
                f"{self._board} is in {encoding.word_of(pb.Mode, state.mode)}: another user works with it",
                remedy=f"When it is free: `board51 send {self._board} stop`, or --park",
            )
        w = self._wishes
        self._limits = limits_of(self._parameters, u_max_v=w.u_max_v, x_min_m=w.x_min_m, x_max_m=w.x_max_m)
        self._folder.claim(identity_of(self._board, self._parameters, w.plant))
        if w.plant.assumed:
            self._write_line(
                "nobody stated the plant: a published CE 152 is assumed (8.28 g, 5.7 mm); K_c and b hold for that only"
            )
        outcomes = [Outcome(experiment=experiment) for experiment in self._with_lift_off(w.experiments)]
        summary = Summary(outcomes=outcomes, lift_off_v=self._folder.lift_off_v)
        # Before anything moves: what the limits forbid is reported at once.
        self._look_ahead(summary)
        self._folder.begin([o.experiment.name for o in outcomes if o.standing == "not-reached"], quick=w.quick)
        self._folder.save(controller_of(self._parameters))  # without the recordings that will be made again
        if all(o.standing != "not-reached" for o in outcomes):
            return summary
        self._x_ref_m = state.x_ref_m if state.HasField("x_ref_m") else None
        began = state
        try:
            self._begin()
            self._all(summary)
            self._folder.settle([outcome.experiment.name for outcome in outcomes])
            self._folder.save(controller_of(self._parameters))
        except Stopped:
            summary.interrupted = True
        except Cut as cut:
            summary.failure = cut.problem.text
        except Board51Error as error:
            summary.failure = str(error)
        finally:
            self._leave(summary)
            summary.rig_s = self._since(began)
        return summary

    # --- before anything moves

    def _with_lift_off(self, experiments: Sequence[Experiment]) -> list[Experiment]:
        """The experiments, with lift-off first if its result is needed and unknown."""
        known = self._folder.lift_off_v is not None or any(e.name == LIFT_OFF for e in experiments)
        if known or not any(map(needs_lift_off, experiments)):
            return list(experiments)
        self._write_line("the lift-off input is not known yet: lift-off is recorded first")
        return [self._wishes.lift_off, *experiments]

    def _look_ahead(self, summary: Summary) -> None:
        """Mark the experiments that are already recorded or not possible within the limits."""
        for outcome in summary.outcomes:
            e = outcome.experiment
            if self._folder.has(e.name, plan_of(e, self._limits, self._wishes.seed)):
                retained = self._folder.retained[e.name]
                outcome.standing = "already-there"
                outcome.attempts, outcome.seconds = retained.attempts, retained.seconds
                continue
            self._folder.drop(e.name)
            plan = actions_of(e, self._scale(e))
            if isinstance(plan, str):
                outcome.standing = "impossible"
                outcome.problems.append(plan)
                self._write_line(f"impossible within the limits: {plan}")

    def _scale(self, experiment: Experiment) -> Scale:
        known = None if experiment.name == LIFT_OFF else self._folder.lift_off_v
        guess = guessed_lift_off_v(self._parameters, self._wishes.plant, self._limits)
        return Scale(
            limits=self._limits,
            travel_m=self._wishes.plant.travel_m,
            lift_off_v=known or guess,
            seed=self._wishes.seed,
        )

    # --- the run

    def _begin(self) -> None:
        if self._parameters.stream_divider != 1:
            self._rig.command(pb.Command(set_stream=pb.SetStream(divider=1)))
        self._rig.land()
        self._rig.measure_rest()

    def _all(self, summary: Summary) -> None:
        total = len(summary.outcomes)
        for number, outcome in enumerate(summary.outcomes, 1):
            e, head = outcome.experiment, f"[{number}/{total}] {outcome.experiment.name}"
            if outcome.standing != "not-reached":
                self._write_line(f"{head}: {outcome.standing.replace('-', ' ')}")
                continue
            if e.person and (why := self._refused(e)):
                outcome.standing = "skipped"
                outcome.problems.append(why)
                self._write_line(f"{head}: skipped, {why}")
                continue
            if needs_lift_off(e) and self._folder.lift_off_v is None:
                outcome.standing = "given-up"
                outcome.problems.append("the lift-off input is not known")
                self._write_line(f"{head}: given up, the lift-off input is not known")
                continue
            ahead = [o.experiment for o in summary.outcomes[number - 1 :] if o.standing == "not-reached"]
            left = sum(experiment.duration_s + OVERHEAD_S[experiment.closed_loop] for experiment in ahead)
            self._write_line(f"{head}, {e.duration_s:.0f} s: {e.purpose} (about {left:.0f} s left)")
            # Until it ends otherwise: an exception leaves this standing.
            outcome.standing = "interrupted"
            self._repeat(outcome)
            summary.lift_off_v = self._folder.lift_off_v

    def _refused(self, experiment: Experiment) -> str:
        if is_emulated(self._parameters.firmware):
            return "the board is emulated: there is no ball to clamp"
        return self._wishes.prepare(experiment)

    def _repeat(self, outcome: Outcome) -> None:
        """Record an experiment with up to ATTEMPTS attempts."""
        e, scale = outcome.experiment, self._scale(outcome.experiment)
        for attempt in range(1, ATTEMPTS + 1):
            outcome.attempts = attempt
            plan = actions_of(e, scale)
            if isinstance(plan, str):
                outcome.problems.append(plan)
                break
            problems, recorded = self._attempt(e, plan)
            if not problems:
                self._keep(outcome, recorded)
                return
            text = "; ".join(problem.text for problem in problems)
            outcome.problems.append(text)
            cures = {problem.cure for problem in problems}
            # Without a cure there is no second attempt: each one takes time at the rig and moves the ball.
            if "none" in cures or attempt == ATTEMPTS:
                break
            if "raise" in cures:
                scale = raised(scale, attempt=attempt)
                how = "with more input"
            elif "lower" in cures:
                scale = replace(scale, u_factor=scale.u_factor * LOWERED, x_factor=scale.x_factor * LOWERED)
                how = "with less amplitude"
            else:
                how = "as it was"
            self._write_line(f"    not usable: {text}; again, {how} ({attempt + 1} of {ATTEMPTS})")
        outcome.standing = "given-up"
        self._write_line(f"    given up: {outcome.problems[-1]}")
        if e.name == LIFT_OFF:
            self._folder.lift_off_v = None

    def _attempt(self, e: Experiment, plan: tuple[Action, ...]) -> tuple[tuple[checks.Problem, ...], Recorded]:
        """Perform an experiment once; returns (problems of the recording, recording)."""
        cut: tuple[checks.Problem, ...] = ()
        try:
            if e.closed_loop:
                self._rig.lift(next(action.x_ref_m for action in plan if isinstance(action, GoTo)))
            # From here on: lifting the ball is no part of the signal.
            self._subscriber.begin()
            for action in plan:
                if not e.closed_loop and not _is_idle(action):
                    self._rig.mode(pb.MODE_OPEN_LOOP)
                self._rig.act(action)
        except Cut as problem:
            cut = (problem.problem,)
        recorded = self._subscriber.end()
        with contextlib.suppress(Cut):  # a reset while landing affects the next experiment only
            self._rig.land()  # raises if another client sent STOP
        if cut:
            return cut, recorded
        # A foreign command makes it another experiment, however good the samples look.
        if intruder := _intruder(recorded):
            return (intruder,), recorded
        samples = Samples.of(map(Sample.of, recorded.states))
        known = checks.CheckedRig(
            limits=self._limits,
            travel_m=self._wishes.plant.travel_m,
            rest_m=self._rig.rest_m,
            sample_time_s=self._parameters.sample_time_s,
        )
        problems = checks.check(e, samples, recorded.captures, recorded.events, known)
        if not problems and e.name == LIFT_OFF:
            self._folder.lift_off_v = checks.lift_off_v(samples, known)
        return problems, recorded

    def _keep(self, outcome: Outcome, recorded: Recorded) -> None:
        e, first, last = outcome.experiment, recorded.states[0], recorded.states[-1]
        outcome.seconds = (last.tick - first.tick) * self._parameters.sample_time_s
        retained = Retained(
            bytes=0,
            seconds=outcome.seconds,
            attempts=outcome.attempts,
            plan=plan_of(e, self._limits, self._wishes.seed),
            said=list(outcome.problems),
        )
        self._folder.keep(e, recorded, retained, controller_of(self._parameters))
        outcome.standing = "recorded"
        if e.name == LIFT_OFF and self._folder.lift_off_v is not None:
            self._write_line(f"    the ball lifts off at u_c = {self._folder.lift_off_v:.3f} V")

    # --- the end

    def _leave(self, summary: Summary) -> None:
        self._subscriber.end()
        summary.parked = self._rig.park()
        if summary.parked:
            return
        if self._x_ref_m is not None:
            why = self._rig.put_back(self._x_ref_m, stream_divider=self._parameters.stream_divider)
            summary.restored += [why] if why else []

    def _since(self, began: pb.State) -> float:
        now = self._subscriber.state or began
        ticks = now.tick - (began.tick if now.session == began.session else 0)  # a reset begins at tick 0
        return ticks * self._parameters.sample_time_s


def _is_idle(action: Action) -> bool:
    return isinstance(action, Send) and action.command.WhichOneof("what") == "set_mode"


def _intruder(recorded: Recorded) -> checks.Problem | None:
    """A problem if another client sent a command during the recording."""
    for record in recorded.commands:
        what = record.command.WhichOneof("what")
        if is_foreign(record) and what != "ping":
            return checks.Problem("intruder", f"{record.command.who or 'somebody'} sent {what} to the board in between")
    return None
