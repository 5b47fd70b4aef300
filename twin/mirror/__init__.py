"""The model in step with a rig, sample by sample: how far apart they are, and whether that is more than noise.

Reading order: loop.py (the free twin), observer.py (the one-step predictor), monitor/expected.py (what noise alone
does), monitor/divergence.py, monitor/alarms.py, then mirror.py, which keeps them in step with the board.
bus/service.py wires it to zenoh.
"""
