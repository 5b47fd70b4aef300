"""Everything about logs: one MCAP file per part, protobuf inside, readable by Foxglove, PlotJuggler and `@mcap/core`.

Reading order: `writer` (one file), `recorder` (queue, thread, rotation, full disk).  Logs are read by `protocol.log`;
on it are built `recover`, `summary`, `replay` (onto the bus), `byte_replay` and `byte_port` (into a gateway) and
`tables` (CSV, MATLAB and Parquet, both ways).
"""
