"""The paper's experiments on a live board, through the bus alone: `board51 campaign run`.

Reading order: `protocol.experiments` (the table), `selection` (which of them), `plan` (the table in volts and metres
of one rig), `checks` (whether a recording is usable).  Then `subscriber` (listens), `control` (commands), `folder` (the
files), `outcome` and `runner` (the sequence).  `selection`, `plan`, `checks` and `outcome` are pure.
"""
