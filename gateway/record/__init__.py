"""Recording, recovery, replay and conversion of logs: MCAP files with protobuf messages.

Foxglove, PlotJuggler and `@mcap/core` can read the files.
Reading order: `writer` (one file), `recorder` (queue, thread, rotation, full disk).  `protocol.log` reads logs; based
on it are `recover`, `summary`, `timeline`, `replay` (onto the bus), `player` (its pace and orders), `byte_replay`
(into a gateway) and `tables` (CSV, MATLAB and Parquet, both ways).
"""
