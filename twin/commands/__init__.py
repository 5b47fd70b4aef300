"""The sub-commands of `board51` that belong to the twin; each has `configure` and `run`."""
