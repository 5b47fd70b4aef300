"""The paper's experiments on a live board, through the bus alone: what `board51 campaign run` does.

Reading order: `menu` (what is done, as a table), `plan` (the table in volts and metres of one rig), `checks` (is a
recording usable), `subscriber` and `rig` (listening, commanding), `folder` (what is kept), `outcome` and `runner` (the
order of it all).  `menu`, `plan`, `checks` and `outcome` are pure.
"""
