"""The catalogue of many logs: a row for each session of a board, in a small database beside the logs."""
