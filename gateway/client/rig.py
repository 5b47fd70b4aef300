"""A board through its gateway: commands, samples, recordings.

Rule 1: a call returns when its command was accepted, and raises otherwise; no command is executed twice.
Rule 2: STOP has priority: it needs no open rig, does not wait for other calls, and is sent until it is answered.
Rule 3: an exception that ends the `with` block stops the board, if this rig has sent a command that may move the ball.
        A block that ends normally leaves the board as it is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

from google.protobuf.message import Message

from gateway.client import commands
from gateway.client.commands import HostLoss, Law, Mode, OperatingPoint, Shape
from gateway.client.connection import BoardConnection, ask, new_id
from gateway.client.errors import accepted
from gateway.client.message_queue import CAPACITY, MessageQueue, SampleStream, check_topic
from gateway.client.values import Capture, Reply, Samples
from protocol.bus import board51_pb2 as pb
from protocol.bus import topics
from protocol.errors import ServiceError

if TYPE_CHECKING:
    from gateway.client.recording import Recording
    from protocol.plant import Plant

SILENCE_S = 3.0  # longest time without a sample; a gateway reconnects a port and reads a board again within it
NEWEST_WAIT_S = 8.0  # periodic messages are sent at least every 5 s
CAPTURE_WAIT_S = 10.0  # reading 2000 samples takes 63 answers of the board
M = TypeVar("M", bound=Message)


class BoardReader(BoardConnection):
    """The base of `Rig` that receives what a board sends: samples, messages, recordings."""

    def samples(
        self, duration_s: float = math.inf, *, timeout_s: float = SILENCE_S, capacity: int = CAPACITY
    ) -> SampleStream:
        """Iterate over the samples from now on: `for sample in rig.samples(2.0):`.

        The duration is in the board's time; the default has no end.  In a full queue of `capacity` samples the oldest
        is dropped and counted in `.dropped`.

        Raises:
            NoSamplesError: during the iteration, no sample arrived for `timeout_s`.
        """
        queue = MessageQueue(self._bus_board, ["state"], capacity=capacity)
        return SampleStream(queue, f"{self.site}/{self.board}", duration_s, timeout_s)

    def read(self, duration_s: float, *, timeout_s: float = SILENCE_S) -> Samples:
        """Read the samples of the next `duration_s` s of the board's time, as arrays of shape (n,), SI units.

        Raises:
            NoSamplesError: no sample arrived for `timeout_s`.
        """
        with self.samples(duration_s, timeout_s=timeout_s) as stream:
            return Samples.of(stream)

    def messages(self, *names: str, timeout_s: float | None = None) -> MessageQueue:
        """Iterate over the messages of some topics from now on: `for event in rig.messages("event"):`.

        The names are those of the interface page: "event", "status", "twin/state", ...  It ends after `timeout_s`
        without a message; None: never.

        Raises:
            UsageError: a name is not a topic that a client can receive.
        """
        for name in names:
            check_topic(name)
        return MessageQueue(self._bus_board, names, timeout_s=timeout_s)

    def status(self, *, timeout_s: float = NEWEST_WAIT_S) -> pb.Status:
        """Wait for the next status of link, bus and log, which is sent every second.

        Raises:
            ServiceError: none arrived within `timeout_s`.
        """
        return self._next("status", pb.Status, timeout_s)

    def parameters(self, *, timeout_s: float = NEWEST_WAIT_S) -> pb.Parameters:
        """Wait for the board's identity, gains, operating point, limits and scalings, which are sent every 5 s.

        Raises:
            ServiceError: none arrived within `timeout_s`.
        """
        return self._next("parameters", pb.Parameters, timeout_s)

    def plant_card(self, *, timeout_s: float = NEWEST_WAIT_S) -> pb.PlantCard:
        """Wait for the plant card, which is sent every 5 s; its `plant` is absent where nobody stated one.

        Raises:
            ServiceError: none arrived within `timeout_s`.
        """
        return self._next("plant", pb.PlantCard, timeout_s)

    def alarms(self, *, timeout_s: float = NEWEST_WAIT_S) -> pb.Alarms:
        """Wait for the gateway's list of alarms with their acknowledgements, which is sent every 5 s.

        Raises:
            ServiceError: none arrived within `timeout_s`.
        """
        return self._next("alarms", pb.Alarms, timeout_s)

    def _next(self, topic: str, kind: type[M], timeout_s: float) -> M:
        with self.messages(topic) as queue:
            message = queue.first(kind, timeout_s)
        if message is not None:
            return message
        problem = f"No {topic} from {self.site}/{self.board} within {timeout_s:g} s"
        raise ServiceError(problem, remedy="Is its gateway running, and is that the board's name?")

    def record(self, directory: Path | str, *, prefix: str = "bus") -> Recording:
        """Record this board to MCAP from now on, until the recording or the rig is closed; creates the directory.

            with rig.record("logs") as recording:
                rig.read(10.0)
            flight = recording.samples()

        Raises:
            UsageError: the directory cannot be created.
            LogError: it is read-only or full.
        """
        from gateway.client.recording import Recording  # with the writer of logs, which no command needs

        recording = Recording(self._bus_board, directory, connect=self.connect, prefix=prefix)
        self._closing.callback(recording.start(needs_room=True).close)
        return recording


class Rig(BoardReader):
    """A board, through its gateway; a context manager that several threads may use at once.

    Args:
        board: Its name.
        connect: The router's endpoint, as `--connect`.
        site: First chunk of the keys, as `--site`.
        identity: Of the client on a guarded bus, as `--identity`: the folder that `board51 security` made, or an
            `Identity`; None: that of BOARD51_IDENTITY, if it is set.
        who: Sender of the commands, for the log; empty: the login name.  A guarded bus uses the identity's name.
        timeout_s: Longest wait for the answer to a command, s; the command does not begin to act later.
        stop_on_error: Whether to send STOP when the block ends with an exception after a command that may move the
            ball.

    Raises:
        ConfigError: endpoint, name or identity is not valid.
        UsageError: `timeout_s` is not positive and finite.
    """

    def set_mode(self, mode: Mode | str) -> Reply:
        """Enter a mode: "idle" (coil off), "open-loop" or "closed-loop"; clears a fault.

        Raises:
            CommandRefusedError: the command was refused; nothing has changed.  All commands raise these two errors.
            CommandNotDeliveredError: the command was not answered.
        """
        return self._execute(commands.set_mode(mode))

    def set_reference(self, x_ref_m: float) -> Reply:
        """Set the position reference, m, up from the sensor; in force from the reply's tick."""
        return self._execute(commands.set_reference(x_ref_m))

    def set_gains(self, gains: Sequence[float], operating_point: OperatingPoint, *, law: Law | str = Law.LQI) -> Reply:
        """Load a control law with gains and operating point, all at one tick (eq. 16-19).

        Args:
            gains: Four, SI: k_i (V/A), k_x (V/m), k_v (V s/m), k_int (V/(m s)) of "lqi"; k_p (V/m), k_int (V/(m s)),
                k_d (V s/m), 0 of "pid".
            operating_point: Of the law.
            law: "lqi" or "pid".
        """
        return self._execute(commands.set_gains(gains, operating_point, law=law))

    def excite(
        self,
        shape: Shape | str,
        *,
        duration_s: float | None = None,
        on_reference: bool = False,
        amplitude: float = 0.0,
        offset: float | None = None,
        period_s: float = 0.0,
        period_end_s: float = 0.0,
        seed: int = 1,
    ) -> Reply:
        """Play a signal on u_c (open loop, V) or on the reference (closed loop, m); returns when it begins.

        Args:
            shape: "step", "rectangle", "sawtooth", "prbs", "multisine" or "chirp"; "none" ends the current signal, and
                u_c or the reference keeps its value.
            duration_s: Of the signal, s; `math.inf`: without end, if the gateway allows that.
            on_reference: Whether the signal is added to the reference instead of u_c.
            amplitude: V or m.
            offset: V or m, absolute; for "none" in open loop: the value that u_c keeps.
            period_s: s; for "prbs" the length of a chip, for "chirp" the first period.
            period_end_s: s; for "chirp" the last period.
            seed: For "prbs" and "multisine".
        """
        command = commands.excite(
            shape, duration_s=duration_s, on_reference=on_reference, amplitude=amplitude, offset=offset,
            period_s=period_s, period_end_s=period_end_s, seed=seed,
        )  # fmt: skip
        return self._execute(command)

    def capture(self, *, u_from_v: float, u_to_v: float, duration_s: float = 0.04, pre_s: float = 0.004) -> Capture:
        """Record the coil current at 25 kHz around a step of u_c, and wait for the result; idle or open loop.

        Of the duration, `pre_s` are before the step.  The result is current and time, shape (n,).

        Raises:
            ServiceError: the command was accepted, but the samples did not arrive.
        """
        with self.messages("capture") as queue:
            command = commands.capture(u_from_v=u_from_v, u_to_v=u_to_v, duration_s=duration_s, pre_s=pre_s)
            reply = self._execute(command)
            record = queue.first(pb.CaptureRecord, CAPTURE_WAIT_S, lambda record: record.tick >= reply.tick)
        if record is not None:
            return Capture.of(record)
        problem = f"The samples of the capture did not arrive from {self.site}/{self.board} within {CAPTURE_WAIT_S:g} s"
        raise ServiceError(problem, remedy="Look at the events of the board: `board51 watch --topic event`")

    def set_stream(self, divider: int) -> Reply:
        """Make the board send every `divider`-th tick; 0: none."""
        return self._execute(commands.set_stream(divider))

    def set_plant(self, plant: Plant, *, confirmed: bool = False) -> Reply:
        """State ball, travel, x_max and gravity of the rig: its plant card, which campaigns use and the gateway keeps.

        `protocol.campaign.load_plant` reads a plant.  Unless they are `confirmed`, unusual values are refused
        ("not-confirmed").
        """
        return self._execute(commands.set_plant(plant, confirmed=confirmed))

    def set_host_loss(self, policy: HostLoss | str, *, timeout_s: float = 1.0) -> Reply:
        """Set what the board does after `timeout_s` without its gateway: "keep", "coil-off" or "hold"."""
        return self._execute(commands.set_host_loss(policy, timeout_s=timeout_s))

    def mark(self, text: str) -> Reply:
        """Add a remark at this moment to every log."""
        return self._execute(commands.mark(text))

    def acknowledge(self, alarm: str, *, comment: str = "") -> Reply:
        """Acknowledge an alarm, such as "divergence-x"; views and logs show it."""
        return self._execute(commands.acknowledge(alarm, comment=comment))

    def shelve(self, alarm: str, duration_s: float, *, comment: str = "") -> Reply:
        """Keep an alarm quiet for a time, s; `acknowledge` brings it back before that."""
        return self._execute(commands.shelve(alarm, duration_s, comment=comment))

    def ping(self) -> Reply:
        """Check that the board answers; raises if not."""
        return self._execute(commands.ping())

    def use_model(self, model: Path | str) -> Reply:
        """Hand a model file of `board51 identify` or `diagnose` to the running twin of this board.

        Raises:
            DataError: the file is missing or too large.
            CommandRefusedError: the twin refuses the model; the message gives the reason.
            ServiceError: no twin answers.
        """
        command = commands.use_model(Path(model))
        command.id, command.who = new_id(), self.who
        role, who = ("", "") if self.identity is None else (self.identity.role, self.identity.name)
        key = topics.command_key(self.site, self.board, role=role, who=who, topic="twin/command")
        reply = ask(self._bus_board.session, key, command, self._timeout_s)
        if reply is None:
            raise ServiceError(
                f"No twin answers for {self.site}/{self.board}",
                remedy="Start `board51 twin`; on a guarded bus only an engineer hands models over",
            )
        return accepted(command, reply)
