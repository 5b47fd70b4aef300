"""Names causes for one board of the live twin: windows in the caller's thread, score tests in another one.

Rule 1: no sample waits for a score test.  While one is at work the next window is dropped and counted.
Rule 2: the answer belongs to the model under which the window was cut; after a change of model it is dropped.
Rule 3: a window that cannot be evaluated says nothing, and so does one in which the ball rests: it shows neither T_A
        nor b, and such flights made a false name.
"""

from __future__ import annotations

import contextlib
import logging
import os
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from functools import partial

import numpy as np

from protocol.bus import board51_pb2 as pb
from twin.diagnosis.report.sentences import finding_sentence
from twin.inference.theta import Theta
from twin.live.naming.decision import Decision, Proposal
from twin.live.naming.evidence import WindowEvidence, evidence_of
from twin.live.naming.windows import Window, Windows
from twin.mirror.output import Output
from twin.mirror.regime import Regime
from twin.model.causes.catalogue import BY_NAME
from twin.model.parameters import Model, Parameter
from twin.settings.naming import MOVES_SHARE

_NICE = 10  # the samples go first, where the system has priorities for threads
_NOT_EVALUATED = (ValueError, ArithmeticError, np.linalg.LinAlgError)
log = logging.getLogger(__name__)


def namers(model: Model) -> Callable[[Model], Namer]:
    """Return what names causes for each board under a model; one thread of low priority does their score tests.

    A made-up window is evaluated first: compiling, or loading what is compiled, would hold up the samples of a flight.
    """
    wave = np.sin(0.1 * np.arange(100))
    readings = np.stack([2.0 + 0.1 * wave, 0.6 + 0.03 * wave, model.plant.travel_m * (0.5 + 0.05 * wave)], axis=1)
    window = Window(
        session=0,
        from_s=0.0,
        to_s=0.2,
        from_ns=0,
        sample_time_s=2e-3,
        i_lsb_a=0.0,
        x_lsb_m=0.0,
        readings=readings,
    )
    with contextlib.suppress(*_NOT_EVALUATED):
        evidence_of(window, model)
    # One thread for all boards: naming takes one core at most.
    work = ThreadPoolExecutor(max_workers=1, thread_name_prefix="naming", initializer=_yield_to_samples)
    return partial(Namer, executor=work)


def _yield_to_samples() -> None:
    with contextlib.suppress(OSError, AttributeError):  # only Linux has priorities for threads
        os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), _NICE)


class Namer:
    """The names of one board.

    Args:
        model: of the twin.
        executor: does the score tests.
    """

    def __init__(self, model: Model, executor: Executor) -> None:
        self._executor = executor
        self.dropped = 0  # windows
        self.use(model)

    def use(self, model: Model) -> None:
        """Begin anew, under another model."""
        self._model = model
        self._windows, self._decision = Windows(), Decision()
        self._work: Future[WindowEvidence] | None = None
        self._theta: Theta | None = None

    def forget(self) -> None:
        """Begin anew: the flight has ended."""
        self.use(self._model)

    def take(self, state: pb.State, output: Output, regime: Regime | None) -> pb.TwinDiagnosis | None:
        """Take a sample; the diagnosis where it is a new one, with an empty `cause` where the last one has ended."""
        before = self._decision.proposal
        self._decision.expire(output.sample.session, output.sample.t_s)
        if self._work is not None and self._work.done():
            self._add(self._work)
            self._work = None
        if regime is not None:
            self._cut(state, output, regime)
        now = self._decision.proposal
        if now is before:
            return None
        return message(now, state)

    def _cut(self, state: pb.State, output: Output, regime: Regime) -> None:
        window = self._windows.take(
            output,
            state.host_time_ns,
            sample_time_s=regime.sample_time_s,
            i_lsb_a=regime.i_lsb_a,
            x_lsb_m=regime.x_lsb_m,
        )
        if window is None or float(np.std(window.readings[:, 2])) < MOVES_SHARE * self._model.plant.travel_m:
            return
        if self._work is not None:
            self.dropped += 1
            return
        # No queue: evidence that has waited is older than the name that it makes.
        self._work = self._executor.submit(evidence_of, window, self._model, self._theta)

    def _add(self, work: Future[WindowEvidence]) -> None:
        try:
            evidence = work.result()
        except _NOT_EVALUATED as error:
            log.warning("a window was not evaluated: %s", error)
            # The next fit begins from the model: the last one may be what failed.
            self._theta = None
            return
        self._theta = evidence.theta
        self._decision.add(evidence)


def message(proposal: Proposal | None, state: pb.State) -> pb.TwinDiagnosis:
    """Return the message about a proposal, or about its absence."""
    if proposal is None:
        return pb.TwinDiagnosis(host_time_ns=state.host_time_ns, session=state.session, tick=state.tick)
    strength = BY_NAME[proposal.cause].strength
    return pb.TwinDiagnosis(
        host_time_ns=state.host_time_ns,
        session=state.session,
        tick=state.tick,
        cause=proposal.cause,
        value=proposal.strength,
        unit=strength.unit,
        probability=proposal.probability,
        others=proposal.others,
        since_ns=proposal.since.from_ns,
        for_s=proposal.until.to_s - proposal.since.from_s,
        sentence=sentence_of(proposal),
    )


def sentence_of(proposal: Proposal) -> str:
    """Return a sentence without its time."""
    known = BY_NAME[proposal.cause]
    values = {one.name: Parameter(value=one.neutral, unit=one.unit) for one in known.parameters[1:]}
    values[known.strength.name] = Parameter(value=proposal.strength, unit=known.strength.unit)
    text = f"the rig behaves as if {finding_sentence(proposal.cause, values)}"
    if proposal.others:
        text += f"; as well possible: {', '.join(BY_NAME[other].title for other in proposal.others)}"
    return text
