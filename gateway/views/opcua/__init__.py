"""OPC UA server for the boards of a site.

Read `address_space/` first (the nodes and their values), then `operations.py` (writes and methods as commands),
`sessions.py` (rights), `server.py` (the complete server).
"""
