"""The names of boards on the bus of a soak; those whose samples are counted are `rig0`, `rig1`, ..."""

PLANT = "plant"  # the one with a ball
GHOST = "ghost"  # ghost3: a replay of rig3
