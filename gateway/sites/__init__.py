"""Store and forward between sites: the log at one site serves what the recording at another has missed.

Reading order: `gateway/record/blocks.py` (what is compared), `server` (beside the rig), `filler` (at the plant).
"""
