"""The subscriber on the interface page, run as it is printed (only the port differs) against a real publisher."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from pathlib import Path

import zenoh

from protocol.bus import board51_pb2 as pb
from protocol.bus import encoding, topics
from protocol.bus.endpoint import zenoh_config
from tests.harness.ports import free_port

ROOT = Path(__file__).parents[2]


def test_the_subscriber_on_the_page_prints_samples() -> None:
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "protocol/README.md").read_text(encoding="utf-8"), re.DOTALL)
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    assert "tcp/127.0.0.1:7447" in code
    state = pb.State(t_s=1.5, x_m=2.85e-3)

    with zenoh.open(zenoh.Config.from_json5(zenoh_config("router", listen=[endpoint]))) as session:
        publisher = session.declare_publisher(topics.key(topics.DEFAULT_SITE, "rig", "state"))
        with subprocess.Popen(
            [sys.executable, "-c", code.replace("tcp/127.0.0.1:7447", endpoint).replace("sleep(5)", "sleep(1)")],
            cwd=ROOT,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        ) as reader:
            deadline = time.monotonic() + 30
            while reader.poll() is None and time.monotonic() < deadline:
                publisher.put(state.SerializeToString(), encoding=encoding.zenoh_encoding(pb.State))
                time.sleep(0.02)  # the rate of the publisher, not a wait for anything
            if reader.poll() is None:
                reader.kill()
            printed, problems = reader.communicate()

    assert reader.returncode == 0, problems
    assert "1.500 s  x =  2.850 mm" in printed
