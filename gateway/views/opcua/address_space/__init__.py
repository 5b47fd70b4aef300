"""The nodes of the OPC UA server: what there is of a board, its values and their quality.

Read `model.py` first (what nodes there are), then `nodes.py` (one board's nodes kept up to date), `quality.py` (status
codes), `history.py` (the last minutes of a variable).
"""
