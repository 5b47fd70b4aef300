"""`board51` commands as child processes: called and ended (`command`), kept running (`supervisor`)."""
