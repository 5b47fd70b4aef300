"""The rigs as an OPC UA server.

Read `address_space/` first (the nodes and their values), then `operations.py` (writes and methods as commands),
`sessions.py` (who may), `server.py` (all of it together).
"""
