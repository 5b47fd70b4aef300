"""The rigs in Foxglove, live and from logs.

Reading order: `scene` (what its 3D panel shows), `derived` (that, and the lines of its Log panel, of all rigs),
`server` (live), `panel_log` (of a log).
"""
