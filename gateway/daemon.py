"""The gateway process: connects boards, bus and log; runs until SIGTERM or SIGINT.

Threads: link (all boards), four publishers (samples, batches of samples, replies, everything else), recorder, zenoh's
own; the main thread waits for signals and publishes the status once a second.

The gateway sends no STOP when it ends: an update or restart must not drop the ball.  Without its host the board follows
its host-loss policy, set in the configuration (default: coil off after 1 s).
"""

from __future__ import annotations

import logging
import logging.handlers
import queue
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import fields
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import zenoh

from gateway.access.authorize import Authorizer
from gateway.access.certificates import WARN_DAYS
from gateway.access.folder import SecurityFolder
from gateway.access.listeners import check_bus_listeners, try_listening
from gateway.bus.command_service import CommandService
from gateway.bus.plant_cards import BoardCard, configured_card, folder_of
from gateway.bus.publisher import GATHER_S, BoardSink, Publisher, Publishers
from gateway.bus.router_watch import RouterWatch
from gateway.bus.status import StatusMaker
from gateway.config import GatewayConfig, LogConfig
from gateway.link.clock import HostClock
from gateway.link.driver import BoardDriver
from gateway.link.io_thread import LinkThread
from gateway.link.port import check_url
from gateway.record.recorder import Recorder, RecorderOptions
from gateway.record.writer import LogError
from protocol.bus import topics
from protocol.bus.encoding import batch, is_replayed, parse, parts
from protocol.bus.endpoint import Mode, zenoh_config
from protocol.bus.identity import SETTINGS, Identity, load_identity
from protocol.ending import on_end_signal
from protocol.errors import ConfigError, ServiceError

STATUS_S = 1.0
# With the default of 5 ms one busy thread delays the others by up to 5 ms, which would dominate the latency.
SWITCH_INTERVAL_S = 0.0005
MESSAGES_QUEUE = 10_000
# Not twin/state and twin/divergence: their batch has the same, and for a subscriber of theirs each tick is sent alone.
_LOGGED_OF_TWIN = ("twin/states", "twin/alarm", "twin/alarms", "twin/model", "twin/diagnosis")
CERTIFICATES_S = 86400.0  # between two checks of their expiry
_logger = logging.getLogger("gateway")


def run(config: GatewayConfig, stop: threading.Event) -> None:
    """Serve until `stop` is set.

    Raises:
        ConfigError: no board, a port that can never be opened, no log directory.
        ServiceError: the bus cannot be opened.
    """
    check(config)
    with ExitStack() as stack:
        bus = stack.enter_context(open_bus(config))
        recorder = _recorder(config.log) if config.log.enabled else None
        publishers = _publishers(config.zenoh.queue)
        replies = Publisher("publish-replies", MESSAGES_QUEUE)
        clock = HostClock()
        sinks = [
            BoardSink(bus, config.site, board.name, publishers, recorder, log_raw=config.log.raw)
            for board in config.boards
        ]
        drivers = [BoardDriver(board, sink, clock) for board, sink in zip(config.boards, sinks, strict=True)]
        if recorder is not None:
            stack.enter_context(_recording(recorder, drivers))
            for subscriber in _log_twin(bus, config.site, recorder):
                stack.callback(subscriber.undeclare)
        cards = [BoardCard(driver, folder_of(config)) for driver in drivers]
        link = LinkThread(drivers, publishers.samples.wake)
        guarded = bool(config.security.directory)
        authorizer = Authorizer(time.time_ns(), partial(_publish_flood, drivers), guarded=guarded)
        queryables = [CommandService(bus, config.site, driver, link, replies, authorizer) for driver in drivers]
        for publisher in (*publishers, replies):
            publisher.start()
            stack.callback(publisher.stop)
        watch = None
        if config.zenoh.mode == "client":
            watch = RouterWatch(bus, ", ".join(config.zenoh.connect), sinks, publishers)
            stack.callback(watch.close)
        link.start()
        for card in cards:
            stack.callback(card.keep)  # what was stated in the last second
        stack.callback(link.stop)
        now_s = look_s = time.monotonic()
        makers = [StatusMaker(driver, sink, now_s) for driver, sink in zip(drivers, sinks, strict=True)]
        _logger.info("serving %d boards as %s on %s", len(drivers), config.site, _where(config))
        while not stop.wait(STATUS_S):
            if watch is not None and (change := watch.look()) is not None:
                _logger.log(logging.INFO if change[1] == "info" else logging.WARNING, "%s", change[2])
                _publish_all(drivers, *change)
            step_ns = clock.step_ns()
            if step_ns:
                authorizer.clock_stepped(step_ns)
                _report_step(drivers, step_ns)
            if guarded and time.monotonic() >= look_s:
                look_s += CERTIFICATES_S
                for text in expiring(config):
                    _publish_all(drivers, "certificate-expires", "warning", text)
            log, now_s = recorder.stats() if recorder is not None else None, time.monotonic()
            for maker, card in zip(makers, cards, strict=True):
                maker.send(log, now_s)
                card.poll(now_s)
        _logger.info("ending; the boards follow their host-loss policy")
        del queryables


def _publishers(samples: int) -> Publishers:
    return Publishers(
        messages=Publisher("publish-messages", MESSAGES_QUEUE),
        samples=Publisher("publish-samples", samples),
        batches=Publisher("publish-batches", samples, gather_s=GATHER_S, join=partial(batch, "state")),
    )


def check(config: GatewayConfig) -> None:
    """Check a configuration without opening anything.

    Raises:
        ConfigError: the configuration is not usable; the message says why.
    """
    check_security(config)
    if not config.boards:
        raise ConfigError(
            "No board is configured",
            remedy="Give --board NAME=PORT, e.g. --board rig1=/dev/ttyUSB0, or a file with [[board]] and --config FILE",
        )
    for board in config.boards:
        check_url(board.port)
        configured_card(board)


def check_security(config: GatewayConfig) -> None:
    """Check listeners, keys and certificates.

    Raises:
        ConfigError: a listener would be unprotected, or a key or certificate is not valid.
    """
    directory = config.security.directory
    if config.zenoh.mode == "router":
        check_bus_listeners(config.zenoh.listen, guarded=bool(directory), insecure=config.security.insecure)
    if not directory:
        keyless = [endpoint for endpoint in config.zenoh.listen if endpoint.startswith(("tls/", "quic/"))]
        if config.zenoh.mode == "router" and keyless:
            raise ConfigError(
                f"The bus at {keyless[0]} has no keys",
                remedy="Make them with `board51 security init DIR` and give --security DIR",
            )
        return
    folder = SecurityFolder(Path(directory))
    if config.zenoh.mode == "router":
        folder.check()
        if folder.site != config.site:
            raise ConfigError(
                f"{directory} guards the site {folder.site}, the gateway serves {config.site}",
                remedy="Give the same --site to `board51 security init` and to the gateway",
            )
    else:
        gateway_identity(config)


def expiring(config: GatewayConfig) -> list[str]:
    """Return one sentence for each certificate that must be renewed soon."""
    try:
        if config.zenoh.mode == "router":
            left = SecurityFolder(Path(config.security.directory)).check()
        else:
            identity = gateway_identity(config)
            left = {"the gateway": (identity.valid_until - datetime.now(UTC)).total_seconds() / 86400}
    except ConfigError as error:
        return [str(error)]
    return [
        f"The certificate of {name} expires in {days:.0f} days: `board51 security renew`, then restart the gateway."
        for name, days in left.items()
        if days < WARN_DAYS
    ]


@contextmanager
def open_bus(config: GatewayConfig) -> Iterator[zenoh.Session]:
    """Open the zenoh session, as router or as client.

    Raises:
        ServiceError: an endpoint is in use or may not be opened.
    """
    z = config.zenoh
    mode: Mode = "router" if z.mode == "router" else "client"
    listen = z.listen if mode == "router" else ()
    for endpoint in listen:
        _check_free(endpoint)
    directory = config.security.directory
    if directory and mode == "router":
        text = SecurityFolder(Path(directory)).router(listen, z.connect, wait_for_router=False)
    else:
        identity = gateway_identity(config) if directory else None
        text = zenoh_config(mode, listen=listen, connect=z.connect, wait_for_router=False, identity=identity)
    try:
        session = zenoh.open(zenoh.Config.from_json5(text))
    except zenoh.ZError as error:
        raise ServiceError(
            f"The bus cannot be opened ({', '.join((*listen, *z.connect))}): {error}",
            remedy="Correct [zenoh] listen and connect, or end what uses the endpoint",
        ) from None
    with session:
        yield session


def _check_free(endpoint: str) -> None:
    """Check that the port is free: zenoh reports a port in use only after five seconds, and not which one."""
    kind, _, rest = endpoint.partition("/")
    host, _, port = rest.partition("?")[0].rpartition(":")
    if kind not in ("tcp", "tls") or not port.isdigit() or int(port) == 0:
        return
    try:
        try_listening(host.strip("[]"), int(port))
    except OSError as error:
        raise ServiceError(
            f"Cannot listen on {endpoint}: {error.strerror}",
            remedy="End the other gateway or router, give another endpoint with --listen,"
            " or join the router there with --connect",
        ) from None


def gateway_identity(config: GatewayConfig) -> Identity:
    """Return the gateway's identity, for a gateway that is a client of a guarded router.

    The folder may be the complete folder of `security init`, or only the gateway's identity.  A machine that is not
    the router does not need the keys of others.

    Raises:
        ConfigError: the identity is not usable.
    """
    path = Path(config.security.directory)
    has_identity = (path / SETTINGS).exists()
    identity = load_identity(path) if has_identity else SecurityFolder(path).identity("gateway")
    identity.check_valid(datetime.now(UTC))
    return identity


def _recorder(log: LogConfig) -> Recorder:
    options = {option.name: getattr(log, option.name) for option in fields(RecorderOptions)}
    return Recorder(Path(log.directory), RecorderOptions(**options))


@contextmanager
def _recording(recorder: Recorder, drivers: Sequence[BoardDriver]) -> Iterator[None]:
    recorder.on_event = partial(_publish_all, drivers)
    try:
        if not recorder.directory.exists():  # what is there and no directory, `start` names
            recorder.directory.mkdir(parents=True, exist_ok=True)
        recorder.start()
    except (OSError, LogError) as error:
        reason = error.strerror if isinstance(error, OSError) else error.reason
        raise ConfigError(
            f"The log cannot be written to {recorder.directory}: {reason}",
            remedy="Give a writable directory with --log-dir, or run without a log with --no-log",
        ) from None
    try:
        yield
    finally:
        recorder.close()


def _publish_all(drivers: Sequence[BoardDriver], name: str, severity: str, text: str) -> None:
    """Publish an event of the gateway under each board, so that viewers of one board see, say, a failing log."""
    for driver in drivers:
        driver.report.publish(name, severity, text)


def _report_step(drivers: Sequence[BoardDriver], step_ns: int) -> None:
    text = f"The host's clock stepped by {step_ns * 1e-9:.3f} s; the samples use the new time from the next session on."
    _publish_all(drivers, "clock-stepped", "warning", text)


def _publish_flood(drivers: Sequence[BoardDriver], who: str, count: int) -> None:
    _publish_all(drivers, "command-flood", "warning", f"{who} sends too many commands: {count} discarded.")


def _log_twin(bus: zenoh.Session, site: str, recorder: Recorder) -> list[zenoh.Subscriber[None]]:
    def log(sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        address = topics.split(key)
        if address is None or is_replayed(sample.attachment):
            return
        site, board, topic = address
        data, now_ns = sample.payload.to_bytes(), time.time_ns()
        if topics.TOPIC_OF_NAME[topic].logged:
            recorder.put(key, data, now_ns)
        elif (message := parse(topics.TOPIC_OF_NAME[topic].message, data)) is not None:
            for name, part in parts(topic, message):
                recorder.put(topics.key(site, board, name), part.SerializeToString(), now_ns)

    return [bus.declare_subscriber(f"{site}/*/{topic}", log) for topic in _LOGGED_OF_TWIN]


def _where(config: GatewayConfig) -> str:
    endpoints = config.zenoh.listen if config.zenoh.mode == "router" else config.zenoh.connect
    guarded = f", guarded by {config.security.directory}" if config.security.directory else ""
    return f"{config.zenoh.mode} {', '.join(endpoints)}{guarded}"


@contextmanager
def logging_to_stderr() -> Iterator[None]:
    """Write log lines to stderr through a queue, so that a full pipe does not block the serial thread."""
    lines: queue.SimpleQueue[logging.LogRecord] = queue.SimpleQueue()
    handler = logging.StreamHandler()
    handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)-7s %(message)s"))
    listener = logging.handlers.QueueListener(lines, handler)
    root = logging.getLogger()
    queued = logging.handlers.QueueHandler(lines)
    root.addHandler(queued)
    root.setLevel(logging.INFO)
    listener.start()
    try:
        yield
    finally:
        root.removeHandler(queued)
        listener.stop()


def serve(config: GatewayConfig) -> int:
    """Run the gateway until SIGTERM or SIGINT, and return the exit code 0."""
    stop = threading.Event()
    sys.setswitchinterval(SWITCH_INTERVAL_S)
    with logging_to_stderr():
        on_end_signal(stop.set)
        run(config, stop)
    return 0
