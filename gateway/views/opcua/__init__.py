"""The rigs as an OPC UA server.

Read `model.py` first (what nodes there are), then `nodes.py` (one board's nodes kept up to date), `quality.py` (status
codes), `desk.py` (writes and methods as commands), `sessions.py` (who may), `server.py` (all of it together).
"""
