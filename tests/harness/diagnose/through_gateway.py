"""A hidden campaign the long way: emulated board, pty, gateway, zenoh, `board51 campaign run`, MCAP files.

The rig is the CE 152, whose [plant] the operator knows; the effect is known to the emulator alone.
"""

from __future__ import annotations

import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path

from tests.harness.diagnose.hidden_campaign import Refused
from tests.harness.gateway.campaign_line import emulated_line

SPEED = 3.0  # times real time; a busy machine still keeps up with it
TIMEOUT_S = 300.0


def record_through_gateway(folder: Path, effects: Mapping[str, float], *, seed: int, quick: bool = False) -> None:
    """Write the campaign; 90 s of the board's time, 25 s if quick, a third of that in ours.

    Raises:
        Refused: the campaign ended early.
    """
    # Beside the folder, not in it: what the gateway keeps must not lie where the diagnosis looks.
    with (
        tempfile.TemporaryDirectory(prefix="line-") as scratch,
        emulated_line(Path(scratch), speed=SPEED, effects=dict(effects)) as line,
    ):
        process = line.start(folder, "--seed", str(seed % 600), *(["--quick"] if quick else []))
        try:
            _, err = process.communicate(timeout=TIMEOUT_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
            raise Refused(f"campaign run has not ended after {TIMEOUT_S:g} s") from None
    if process.returncode != 0:
        shutil.rmtree(folder, ignore_errors=True)
        last = err.strip().splitlines()[-1:] or [""]
        raise Refused(f"campaign run ended with {process.returncode}: {last[0]}")
