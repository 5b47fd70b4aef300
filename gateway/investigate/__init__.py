"""Campaign and diagnosis in turns on a live board, until one name is left: what `board51 investigate` does.

Reading order: `answer` (what a diagnosis says), `decide` (the next step, and why: pure), `folder` (what was done, to go
on after an end), `work` (the commands that do it), `investigator` (the loop).  It imports nothing of the twin: rig and
diagnosis are reached through `board51 campaign run` and `board51 diagnose`.
"""
