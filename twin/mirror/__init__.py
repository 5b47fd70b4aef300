"""The model in step with a rig, sample by sample: how far apart they are, and whether that is more than noise.

Read loop.py (the free twin) first, then observer.py (the one-step predictor) and monitor/expected.py (the effect of
noise alone).  monitor/divergence.py and monitor/alarms.py follow; mirror.py keeps them in step with the board, and
bus/service.py wires it to zenoh.
"""
