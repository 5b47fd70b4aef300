"""`board51` commands as child processes: start and end (`command`), run with a log (`run`), keep (`supervisor`)."""
