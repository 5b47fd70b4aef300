# %% [markdown]
# # Subscribe, command, replay
#
# A live rig from Python: read its samples, move the ball, record a flight, and read the recording back. Start a rig
# first, in two terminals:
#
#     board51 emulate --tcp 127.0.0.1:5100
#     board51 gateway --board rig1=socket://127.0.0.1:5100
#
# Run it cell by cell, or as it is: `python subscribe_command_replay.py [ENDPOINT]`. SI units throughout.

# %%
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from gateway.client import CommandRefusedError, Rig

words = [] if "ipykernel" in sys.modules else sys.argv[1:]  # those of a notebook are Jupyter's own
endpoint = words[0] if words else "tcp/127.0.0.1:7447"
rig = Rig("rig1", connect=endpoint).open()  # in a program: with Rig(...) as rig:
print(rig.parameters().firmware, f"{1e3 * rig.parameters().sample_time_s:g} ms")

# %% [markdown]
# ## 1 Subscribe
#
# Samples come one by one in a loop, or as arrays. The time base is the board's tick.

# %%
for sample in rig.samples(0.01):
    print(f"{sample.t_s:9.3f} s  x = {1e3 * sample.x_m:.3f} mm  {sample.mode}")

noise = rig.read(1.0)
print(f"{len(noise)} samples at rest, position noise {1e6 * noise.x_m.std():.1f} um rms")

# %% [markdown]
# ## 2 Command
#
# A command returns when the board has accepted it, with the tick from which it is in force. A refused command raises an
# error with the reason.

# %%
folder = Path(tempfile.mkdtemp(prefix="board51-"))
recording = rig.record(folder)
rig.set_reference(0.002)
rig.set_mode("closed-loop")
rig.read(1.0)
begun = rig.set_reference(0.003)
flight = rig.read(1.0)
after_s = flight.t_s - flight.t_s[np.searchsorted(flight.tick, begun.tick)]
print(f"0.5 s after the step the ball is at {1e3 * flight.x_m[np.searchsorted(after_s, 0.5)]:.2f} mm")

# %%
try:
    rig.set_reference(0.1)
except CommandRefusedError as refused:
    print(refused)

# %%
rig.stop()  # coil off at once; goes out whatever else waits
recording.close()
logged = recording.samples()
print(f"{len(logged)} samples in {recording.files[0].name}, {recording.stats.dropped} dropped")

# %% [markdown]
# ## 3 Replay
#
# The log goes back onto the bus under another name; a subscriber of `ghost` sees the flight again.

# %%
ghost = Rig("ghost", connect=endpoint).open()
stream = ghost.samples()
words = [sys.executable, "-m", "board51", "replay", str(recording.files[0])]
player = subprocess.Popen([*words, "--connect", endpoint, "--as", "ghost", "--speed", "4"], stdout=subprocess.DEVNULL)
again = [sample for _, sample in zip(range(len(logged)), stream, strict=False)]
assert player.wait() == 0
assert [sample.tick for sample in again] == logged.tick.tolist()
print(f"replayed: {len(again)} samples, the same ticks")

# %%
stream.close()
ghost.close()
rig.close()
