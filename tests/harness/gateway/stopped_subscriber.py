"""A healthy subscriber beside a stopped one, on any bus: what does the healthy one notice?"""

from __future__ import annotations

import signal
import subprocess
import sys
import threading
import time

import zenoh

from tests.harness.gateway.gateway_peers import wait_for

KEY = "board51/rig/state"
ROUND = 32  # messages between two looks at the healthy one
PAYLOAD = bytes(16_000)
# More than the stopped one's zenoh queue (1 MiB) and the system's buffers of both ends (a few MB each) can hold.
ROUNDS = 48_000_000 // (ROUND * len(PAYLOAD))
# zenoh blocks for 5 s; half of it is far beyond what a busy machine costs a message.
STALL_S = 2.5
QUESTIONS = 20

STOPPED = """
import sys, time, zenoh
with zenoh.open(zenoh.Config.from_json5(sys.argv[1])) as session:
    session.declare_subscriber("board51/**", lambda sample: None)
    asked = [session.get(sys.argv[2], timeout=120) for _ in range(int(sys.argv[3]))]
    print("ready", flush=True)
    time.sleep(120)
"""


def longest_round_s(
    publishing: zenoh.Session, healthy: zenoh.Session, stopped: str, command: str = "board51/rig/command"
) -> float:
    """Publish through a stop; the longest time in which a round reached the healthy subscriber, every message of it.

    The stopped one has asked questions before, which are answered between the rounds.

    Args:
        publishing: the gateway's session.
        healthy: a client of the bus.
        stopped: configuration of the client that is stopped.
        command: the key it asks.
    """
    got, more = 0, threading.Condition()
    queries: list[zenoh.Query] = []

    def count_sample(sample: zenoh.Sample) -> None:
        nonlocal got
        with more:
            got += 1
            more.notify()

    publisher = publishing.declare_publisher(KEY, congestion_control=zenoh.CongestionControl.BLOCK)
    queryable = publishing.declare_queryable(command, queries.append)
    words = [sys.executable, "-c", STOPPED, stopped, command, str(QUESTIONS)]
    process = subprocess.Popen(words, stdout=subprocess.PIPE)
    assert process.stdout is not None
    try:
        process.stdout.readline()
        with healthy.declare_subscriber(KEY, count_sample):
            with more:
                while not got:  # until the subscription is known
                    publisher.put(PAYLOAD)
                    more.wait(0.05)
            time.sleep(0.3)  # what was put meanwhile has arrived: from here on every message is counted
            wait_for(lambda: len(queries) == QUESTIONS, "questions")
            process.send_signal(signal.SIGSTOP)
            longest_s = 0.0
            for turn in range(ROUNDS):
                began_s = time.monotonic()
                with more:
                    got = 0
                if queries and turn > ROUNDS // 2:  # by then nothing more fits anywhere
                    with queries.pop() as query:
                        query.reply(command, b"answer")
                for _ in range(ROUND):
                    publisher.put(PAYLOAD)
                with more:
                    while got < ROUND:
                        assert more.wait(30.0), "a healthy subscriber lost messages"
                longest_s = max(longest_s, time.monotonic() - began_s)
            assert not queries
            return longest_s
    finally:
        process.kill()
        process.wait()
        process.stdout.close()
        queryable.undeclare()
