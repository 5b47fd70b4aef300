"""Hosts on one machine, as network namespaces, and lines between them that delay, lose and are cut.  Needs root.

The lines are of this file, because not every kernel has netem: two TUN devices, and a thread that passes their packets.
"""

from __future__ import annotations

import fcntl
import heapq
import itertools
import os
import random
import select
import struct
import subprocess
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

_TUN, _TUNSETIFF = Path("/dev/net/tun"), 0x400454CA
_IFF_TUN_NO_PI = 0x0001 | 0x1000
_PACKET = 65536


def why_not() -> str:
    """Return the reason why there can be no namespaces here; it is empty if there can."""
    if os.name != "posix" or not hasattr(os, "geteuid") or os.geteuid() != 0:
        return "namespaces need root on Linux"
    if not _TUN.exists():
        return f"no {_TUN}"
    name = f"b51-{os.getpid()}"
    try:
        subprocess.run(["ip", "netns", "add", name], check=True, capture_output=True)
    except (OSError, subprocess.CalledProcessError) as error:
        return f"ip netns add fails: {error}"
    subprocess.run(["ip", "netns", "del", name], check=True)
    return ""


@contextmanager
def host(name: str) -> Iterator[list[str]]:
    """A namespace with its loopback up; yields the words before a command that runs in it."""
    full = f"b51-{os.getpid()}-{name}"
    subprocess.run(["ip", "netns", "add", full], check=True)
    try:
        subprocess.run(["ip", "-n", full, "link", "set", "lo", "up"], check=True)
        yield ["ip", "netns", "exec", full]
    finally:
        subprocess.run(["ip", "netns", "del", full], check=True)


class Line:
    """A line between two hosts; their addresses on it are `<network>.1` and `<network>.2`.

    Args:
        hosts: Words of the two hosts.
        network: First three bytes of the addresses.
        delay_s: Of each packet, one way.
        loss: Share of the packets that are lost, each way.
        seed: Of the losses.
    """

    def __init__(
        self, hosts: tuple[list[str], list[str]], network: str, *, delay_s: float, loss: float, seed: int
    ) -> None:
        self._delay_s, self._loss, self._draw = delay_s, loss, random.Random(seed)
        self._ends, self.is_cut, self.passed_bytes, self.lost = list[int](), False, 0, 0
        self._stop = threading.Event()
        for number, words in enumerate(hosts, 1):
            end = os.open(_TUN, os.O_RDWR | os.O_NONBLOCK)
            device = f"b{os.getpid()}-{network.rpartition('.')[2]}{number}"
            fcntl.ioctl(end, _TUNSETIFF, struct.pack("16sH", device.encode(), _IFF_TUN_NO_PI))
            self._ends.append(end)
            namespace, peer = words[-1], f"{network}.{3 - number}"
            subprocess.run(["ip", "link", "set", device, "netns", namespace], check=True)
            address = ["addr", "add", f"{network}.{number}", "peer", peer, "dev", device]
            subprocess.run(["ip", "-n", namespace, *address], check=True)
            subprocess.run(["ip", "-n", namespace, "link", "set", device, "up"], check=True)
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the line."""
        self._stop.set()
        self._thread.join()
        for end in self._ends:
            os.close(end)

    def _work(self) -> None:
        waiting: list[tuple[float, int, int, bytes]] = []
        numbers = itertools.count()
        while not self._stop.is_set():
            wait_s = max(0.0, waiting[0][0] - time.monotonic()) if waiting else 0.1
            for end in select.select(self._ends, [], [], min(wait_s, 0.1))[0]:
                try:
                    packet = os.read(end, _PACKET)
                except BlockingIOError:
                    continue
                sink = self._ends[1 - self._ends.index(end)]
                if self.is_cut or self._draw.random() < self._loss:
                    self.lost += 1
                else:
                    heapq.heappush(waiting, (time.monotonic() + self._delay_s, next(numbers), sink, packet))
            while waiting and waiting[0][0] <= time.monotonic():
                _, _, sink, packet = heapq.heappop(waiting)
                self.passed_bytes += len(packet)
                try:
                    os.write(sink, packet)
                except OSError:  # the device is going down
                    self.lost += 1
