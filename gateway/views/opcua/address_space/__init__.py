"""The nodes of the OPC UA server: variables and methods of a board, with values and quality.

Read `model.py` first (definition of the nodes), then `nodes.py` (update of one board's nodes), `quality.py` (status
codes), `history.py` (the last minutes of a variable).
"""
