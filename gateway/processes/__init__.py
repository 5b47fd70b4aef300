"""`board51` commands as child processes: start, wait for and end (`command`), keep (`supervisor`)."""
