"""The sub-commands of `board51` of the twin; each has `configure` and `run`."""
