"""The sub-commands of `board51` that belong to the gateway; each has `configure` and `run`."""
