"""Lift the ball, record 2 s of it, coil off; with Python's own library: python3 fly.py [URL [TOKEN]]."""

import json
import sys
import time
import urllib.request
from typing import Any

RIG = sys.argv[1] if len(sys.argv) > 1 else "http://127.0.0.1:8051/api/v1/rigs/rig1"
HEADERS = {"Authorization": f"Bearer {sys.argv[2]}"} if len(sys.argv) > 2 else {}


def ask(path: str, **body: object) -> Any:
    request = urllib.request.Request(RIG + path, json.dumps(body).encode() if body else None, HEADERS)
    with urllib.request.urlopen(request, timeout=15) as answer:
        return json.load(answer)


try:
    ask("/commands?soft_errors=true", command="mode", mode="closed-loop")
    reply = ask("/commands?soft_errors=true", command="reference", x_ref_m=0.003)
    print("executed" if reply["executed"] else f"refused: {reply['message']} {reply['remedy']}")
    time.sleep(2)
    samples = ask("/states?last_s=2")
    print(f"{len(samples['x_m'])} samples, at last x = {1e3 * samples['x_m'][-1]:.3f} mm")
finally:
    ask("/stop", by="fly.py")
