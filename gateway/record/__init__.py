"""Everything about logs: one MCAP file per part, protobuf inside, readable by Foxglove, PlotJuggler and `@mcap/core`.

Reading order: `writer` (one file), `recorder` (queue, thread, rotation, full disk), `scan` with `chunk` (bytes of a
file into messages), `reader` (messages into records); then what is built on them: `recover`, `summary`, `replay` (onto
the bus), `byte_replay` and `byte_port` (into a gateway), `tables` (CSV, MATLAB and Parquet, both ways).
"""
