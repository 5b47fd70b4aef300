"""The rigs in Foxglove, live and from logs.

Reading order: `lines` and `scene` (what its Log and 3D panels show), `derived` (both, of all rigs), `server` (live),
`panel_log` (of a log).
"""
