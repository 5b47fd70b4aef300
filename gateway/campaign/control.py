"""Commands to the board and waits, by the board's clock.

Rule 1: time is counted in ticks: 2 s are 1000 ticks of the stream, however late they arrive.
Rule 2: every wait ends: at its tick, with `Stopped` (Ctrl-C), or with a ServiceError if no more samples arrive.
        `Cut` ends it if the attempt failed: reset, fault, ball at a stop.
Rule 3: `park` never raises, because it is called after every error.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable

import zenoh

from gateway.campaign.checks import AT_STOP_S, STOP_SHARE, Cure, Problem, rest_level_m
from gateway.campaign.plan import CAPTURE_PRE_S, CAPTURE_S, Action, GoTo, Send, Shoot
from gateway.campaign.subscriber import ID_PREFIX, BoardSubscriber
from gateway.client.connection import new_id
from gateway.client.rig import Rig
from protocol.bus import board51_pb2 as pb
from protocol.bus.plant_card import card_plant
from protocol.campaign import Plant
from protocol.errors import Board51Error, ServiceError
from protocol.wire.messages import Flag

SILENCE_S = 3.0  # longest time without a state; the gateway reconnects a port and reads a board again within it
# The plant card comes every 5 s, later on a busy machine; only an older gateway sends none.
CARD_WAIT_S = 15.0
SETTLE_S = 4.0  # longest time from the command to the ball resting at its reference
STEADY_S = 0.25
LANDING_S = 0.3  # a fall through the travel takes 0.03 s, its bounces ten times that
CAPTURE_LIMIT_S = 5.0
_AGAIN = ("flood", "queue-full", "slew", "busy", "no-session", "not-available")
_AGAIN_LIMIT_S = 5.0


class Stopped(Exception):  # noqa: N818  # not an error: somebody wanted it
    """Ctrl-C or SIGTERM."""


class Cut(Exception):  # noqa: N818  # an expected outcome of an attempt
    """The attempt gives no usable recording."""

    def __init__(self, code: str, text: str, *, cure: Cure = "again") -> None:
        super().__init__(text)
        self.problem = Problem(code, text, cure)


class Dwell:
    """Measures how long a condition holds without a break, by the board's clock."""

    def __init__(self, sample_time_s: float) -> None:
        self._sample_time_s = sample_time_s
        self._since: int | None = None  # tick

    def update(self, tick: int, *, holds: bool) -> float:
        """Return for how long the condition has held at this tick, s; 0 if it does not hold."""
        if not holds:
            self._since = None
        elif self._since is None:
            self._since = tick
        return 0.0 if self._since is None else (tick - self._since) * self._sample_time_s


def _check_state(state: pb.State, session: int) -> None:
    if state.session != session:
        raise Cut("board-reset", "the board began a new session in between")
    if state.flags & Flag.FAULT:
        raise Cut("fault", "the board reports a fault")
    if state.flags & Flag.HOST_LOST:
        raise Cut("host-lost", "the board did not hear its host and has acted on its own")


def _lost(what: str, address: str) -> ServiceError:
    return ServiceError(
        f"{what} from {address} for {SILENCE_S:g} s: gateway, link or board has failed",
        remedy="Look at `board51 watch --topic status`. When it is back, repeat the command: it continues",
    )


class RigControl:
    """The control of one board through its gateway, until `stop` is set."""

    def __init__(self, rig: Rig, subscriber: BoardSubscriber, stop: threading.Event) -> None:
        self._rig, self._subscriber, self._stop = rig, subscriber, stop
        self._address = f"{rig.site}/{rig.board}"
        self.travel_m = self.rest_m = float("nan")  # set before the ball moves

    # --- waiting

    def wait(self, ready: Callable[[], bool], *, timeout_s: float | None = None) -> bool:
        """Wait until `ready()` is true (tested after each message with the subscriber locked); False at the time-out.

        Raises:
            Stopped: the user ends the run.
            ServiceError: board, link or gateway is gone, or another client sent STOP, after which the campaign must not
                lift the ball again.
        """
        end_s = None if timeout_s is None else time.monotonic() + timeout_s
        with self._subscriber.changed:
            while not ready():
                self._heed()
                if self._subscriber.silence_s() > SILENCE_S:
                    raise _lost("No samples", self._address)
                if end_s is not None and time.monotonic() > end_s:
                    return False
                # With a time-out, because the silence of a board wakes nobody.
                self._subscriber.changed.wait(0.05)
        if self._stop.is_set():
            raise Stopped
        return True

    def _heed(self) -> None:
        if self._stop.is_set():
            raise Stopped
        if self._subscriber.stop_sender is not None:
            raise ServiceError(
                f"{self._subscriber.stop_sender} stopped the board",
                remedy="When it is safe again, the same command continues where it stopped",
            )

    def await_board(self) -> tuple[pb.State, pb.Parameters]:
        """Wait for the first state, the gateway's status and the parameters, which are sent every 5 s.

        The status has the time of the last STOP, which may have come while this process started.

        Raises:
            ServiceError: one of them does not come, or there was a STOP since the run was ordered.
        """
        self.wait(lambda: self._subscriber.state is not None)
        is_known = self.wait(
            lambda: self._subscriber.parameters is not None and self._subscriber.status is not None, timeout_s=8.0
        )
        if not is_known:
            raise ServiceError(
                f"{self._address} streams but does not send its parameters and status", remedy="Restart its gateway"
            )
        self._heed()
        return self._subscriber.newest, self._subscriber.newest_parameters

    def await_card(self) -> Plant | None:
        """Wait for the rig's plant card; None where nobody stated the plant, or the gateway sends no card.

        Raises:
            Stopped, ServiceError: as `wait`.
        """
        self.wait(lambda: self._subscriber.state is not None)
        self.wait(lambda: self._subscriber.card is not None, timeout_s=CARD_WAIT_S)
        return card_plant(self._subscriber.card)

    def hold(self, duration_s: float, *, from_tick: int | None = None) -> None:
        """Wait for `duration_s` of the board's time, from now or from a tick.

        Raises:
            Cut: the board was reset, reports a fault or a lost host, or the ball is at a stop in closed loop.
        """
        first, period_s = self._subscriber.newest, self._subscriber.newest_parameters.sample_time_s
        start = first.tick if from_tick is None else from_tick
        due = start + round(duration_s / period_s)
        dwell = Dwell(period_s)

        def over() -> bool:
            state = self._subscriber.newest
            _check_state(state, first.session)
            fallen = state.mode == pb.MODE_CLOSED_LOOP and self._at_stop(state)
            if dwell.update(state.tick, holds=fallen) > 2 * AT_STOP_S + STEADY_S:
                raise Cut("ball-fell", "the ball fell out of the loop", cure="lower")
            return state.tick >= due

        self.wait(over)

    def _at_stop(self, state: pb.State) -> bool:
        height = (state.x_m - self.rest_m) / self.travel_m
        return state.HasField("x_m") and not STOP_SHARE < height < 1.0 - STOP_SHARE

    # --- commands

    def command(self, command: pb.Command) -> int:
        """Send a command, repeat it after a temporary refusal; returns the tick from which it is in force.

        Raises:
            Cut: it was refused.
            Stopped: the user ends the run.
            ServiceError: it was not delivered, or another client sent STOP.
        """
        end_s = time.monotonic() + _AGAIN_LIMIT_S
        while True:
            self._heed()
            reply = self._send(command)
            if reply.accepted:
                return reply.tick
            if reply.reason == "not-delivered":
                raise _lost("No answer to a command", self._address)
            if reply.reason not in _AGAIN or time.monotonic() > end_s:
                what = str(command.WhichOneof("what")).replace("_", " ")
                text = f"{what} was refused by the {reply.refused_by}: {reply.reason}: {reply.text}".rstrip(".")
                raise Cut("refused", text, cure="none" if reply.reason == "out-of-range" else "again")
            self._stop.wait(0.1)

    def _send(self, command: pb.Command, *, timeout_s: float = 5.0) -> pb.CommandReply:
        request = pb.Command()
        request.CopyFrom(command)
        # A new id for each attempt: under the old one the gateway would repeat the refusal that it kept.
        request.id = f"{ID_PREFIX}{new_id()}"
        return self._rig.send(request, timeout_s=timeout_s)

    def mode(self, mode: pb.Mode) -> None:
        """Enter a mode."""
        self.command(pb.Command(set_mode=pb.SetMode(mode=mode)))

    def act(self, action: Action) -> None:
        """Perform one action of a plan."""
        match action:
            case Send():
                # From the tick of the reply: the time that the line takes is no part of the hold.
                tick = self.command(action.command)
                self.hold(action.hold_s, from_tick=tick)
            case GoTo():
                self.go_to(action.x_ref_m)
                self.hold(action.hold_s)
            case Shoot():
                self._shoot(action)

    def _shoot(self, shot: Shoot) -> None:
        level = pb.Excite(shape=pb.SHAPE_NONE, offset=shot.u_from_v)
        tick = self.command(pb.Command(excite=level))
        self.hold(shot.lead_s, from_tick=tick)
        with self._subscriber.changed:
            before, session = self._subscriber.captures, self._subscriber.newest.session
            capture_s = self._subscriber.newest_parameters.capture_s
        lasts_s = min(CAPTURE_S, capture_s or CAPTURE_S)  # an older gateway does not state it
        capture = pb.Capture(u_from_v=shot.u_from_v, u_to_v=shot.u_to_v, duration_s=lasts_s, pre_s=CAPTURE_PRE_S)
        self.command(pb.Command(capture=capture))

        def arrived() -> bool:
            _check_state(self._subscriber.newest, session)
            return self._subscriber.captures > before

        if not self.wait(arrived, timeout_s=CAPTURE_LIMIT_S):
            raise Cut("captures-missing", "the samples of a capture did not arrive")

    def go_to(self, x_ref_m: float) -> None:
        """Move the reference in steps within the board's limit."""
        parameters = self._subscriber.newest_parameters
        # Less than the board allows: both ends of the jump are rounded to counts.
        step_m, count_m = 0.95 * parameters.x_ref_step_max_m, abs(parameters.x_lsb_m)
        while True:
            at_m = self._subscriber.newest.x_ref_m
            left_m = x_ref_m - at_m
            if abs(left_m) <= count_m:
                return
            target_m = x_ref_m if abs(left_m) <= step_m else at_m + (step_m if left_m > 0 else -step_m)
            tick = self.command(pb.Command(set_reference=pb.SetReference(x_ref_m=target_m)))
            session = self._subscriber.newest.session

            def has_tick(tick: int = tick, session: int = session) -> bool:
                _check_state(self._subscriber.newest, session)
                return self._subscriber.newest.tick >= tick

            self.wait(has_tick)

    def lift(self, x_ref_m: float) -> None:
        """Close the loop and wait until the ball is steady at the reference.

        Raises:
            Cut: it does not get there.
        """
        self.go_to(x_ref_m)
        self.mode(pb.MODE_CLOSED_LOOP)
        period_s, session = self._subscriber.newest_parameters.sample_time_s, self._subscriber.newest.session
        first, dwell = self._subscriber.newest.tick, Dwell(period_s)

        def steady() -> bool:
            state = self._subscriber.newest
            _check_state(state, session)
            is_close = abs(state.x_m - state.x_ref_m) < STOP_SHARE * self.travel_m and not self._at_stop(state)
            steady_s = dwell.update(state.tick, holds=is_close)
            if (state.tick - first) * period_s > SETTLE_S:
                height_mm, aim_mm = ((x_m - self.rest_m) * 1e3 for x_m in (state.x_m, state.x_ref_m))
                text = (
                    f"{SETTLE_S:g} s after closing the loop the ball is at {height_mm:.2f} mm above its rest, the"
                    f" reference at {aim_mm:.2f} mm"
                )
                raise Cut("reference-not-reached", text)
            return steady_s >= STEADY_S

        self.wait(steady)

    def measure_rest(self) -> None:
        """Measure the reading of x at rest, with the coil off."""
        with self._subscriber.changed:
            # Only states from now on: older ones may show a ball that still bounces.
            self._subscriber.recent.clear()
        self.wait(lambda: len(self._subscriber.recent) >= 50)
        self.rest_m = rest_level_m([state.x_m for state in self._subscriber.recent if state.HasField("x_m")])

    def land(self) -> None:
        """End an experiment: send STOP and wait until the ball has landed."""
        self.command(pb.Command(stop=pb.Stop()))
        self.hold(LANDING_S)

    def park(self) -> str:
        """Send STOP; returns "" or why it could not be delivered.  Never raises."""
        why = "no answer"
        # Three attempts: the worst end of a run is a coil that stays on.
        for _ in range(3):
            with contextlib.suppress(Board51Error, zenoh.ZError):
                reply = self._send(pb.Command(stop=pb.Stop()), timeout_s=2.0)
                if reply.accepted:
                    return ""
                why = f"{reply.reason}: {reply.text}".rstrip(".")
            time.sleep(0.1)
        return why

    def put_back(self, x_ref_m: float, *, stream_divider: int) -> str:
        """Restore reference and stream; returns "" or why that was not possible."""
        self._stop = threading.Event()  # the user's stop and
        self._subscriber.stop_sender = None  # the STOP of another client have been handled
        try:
            self.go_to(x_ref_m)
            if stream_divider != 1:
                self.command(pb.Command(set_stream=pb.SetStream(divider=stream_divider)))
        except (Cut, Board51Error) as error:
            return f"the reference could not be put back to {x_ref_m * 1e3:.3f} mm: {error}"
        return ""
