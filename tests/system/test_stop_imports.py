"""A STOP of the command line is a start of Python; what it imports is time with the coil on.

The modules are counted: seconds would measure how busy this machine is.
"""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

from tests.harness.gateway.bus_peers import played_gateway
from tests.patience import HANG_S

ROOT = Path(__file__).parents[2]
SEND = """
import json, sys
before = set(sys.modules)
import board51
code = board51.main(sys.argv[1:])
print(json.dumps([code, sorted(set(sys.modules) - before)]))
"""
PROJECT_PACKAGES = ("board51", "gateway", "protocol", "twin")


def test_a_stop_of_the_command_line_imports_the_bus_and_no_more() -> None:
    with played_gateway() as gateway:
        process = subprocess.run(
            [sys.executable, "-c", SEND, "send", "rig", "stop", "--connect", gateway.endpoint],
            cwd=ROOT,
            capture_output=True,
            text=True,
            timeout=HANG_S,
            check=True,
        )

    accepted, result = process.stdout.splitlines()
    code, modules = json.loads(result)
    packages = {name.partition(".")[0] for name in modules}
    assert (code, accepted) == (0, "accepted, in force from tick 7")
    assert [command.WhichOneof("what") for _, command in gateway.commands] == ["stop"]
    assert packages - sys.stdlib_module_names <= {*PROJECT_PACKAGES, "zenoh", "google"}
    assert not {"google.protobuf.json_format", "google.protobuf.descriptor_pb2", "tomllib", "uuid"} & set(modules)
    assert sum(name.partition(".")[0] in PROJECT_PACKAGES for name in modules) <= 24
    assert len(modules) < 125  # 108 with Python 3.11
