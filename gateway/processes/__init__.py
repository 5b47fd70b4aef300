"""`board51` commands as child processes: start and end (`command`), supervision (`supervisor`)."""
